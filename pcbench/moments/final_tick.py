"""What is true of the errors at tick N - 1, and what observers believe of them: both are in the moments of a cell already."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.moments.error_sums import Read
from pcbench.moments.events import Means
from pcbench.simulation import innovation_stats
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import Layout


class Last(NamedTuple):
    """Tick N - 1: what is true of the errors, and what observers believe of them."""

    covariance: Array  # [Z, Z, C]
    believed: dict[str, Array]  # by observer that has a covariance, of what it estimates: [z, z, C]


def kept(by: Means, k: Array, here: Array, mean: Run, read: Read, before: Last) -> Last:
    """Return what there is of errors and of what observers believe of them, where the one tick read is that for it."""
    Z = read.runs.errors.shape[2]
    nothing = jnp.zeros((0, by.std.shape[1]))

    def found() -> Last:
        return Last(read.covariance[0, :Z, :Z], by.over(partial(_believed, by.layout))(k, mean, nothing, ()))

    return lax.cond(here, found, lambda: before)


def _believed(layout: Layout, p: Any, k: Array, run: Run, nothing: Any, rest: Any) -> dict[str, Array]:
    """What the observers of one cell believe of their errors at tick k."""
    return innovation_stats.covariances(layout, p, k, run.memories, run.commands)


def nothing(by: Means, mean: Run, signals: int) -> Last:
    """Return room for what is kept of the last tick."""
    cells, zero = by.std.shape[1], jnp.asarray(0)
    shapes = jax.eval_shape(lambda: by.over(partial(_believed, by.layout))(zero, mean, jnp.zeros((0, cells)), ()))
    return Last(jnp.zeros((signals, signals, cells)), jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes))
