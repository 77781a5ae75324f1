"""Treatment of outliers in a filter: reject a sample with a large innovation, or reduce its weight.

With nu the innovation of a channel, s its assumed variance and z = |nu| / sqrt(s):

    gate:   z > gate: the channel is rejected, unless `opens` of its samples were rejected in a row; then it is used
    huber:  z > k: s <- s z / k, so that the correction does not grow any more; the variance r of the noise follows

A gate that never opens may lock up: a filter with a large error rejects all samples that could correct it. `huber` is one
step of Huber's M-estimator.
Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4; Huber 1964, 'Robust estimation of a location parameter'.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, PyTree
from pydantic import Field

from pcbench.observers.parts.kalman import Posterior
from pcbench.protocols import Leaf

GATE: Any = Field(
    None,
    gt=0,
    description="number of standard deviations of the innovation beyond which a sample is rejected; default: no gate",
)
OPENS: Any = Field(5, ge=1, le=10_000, description="number of rejected samples in a row after which the next is used")
HUBER: Any = Field(
    None,
    gt=0,
    description="number of standard deviations beyond which the weight of an innovation decreases; default: no limit",
)


class Guard(NamedTuple):
    """Thresholds in standard deviations of an innovation; inf: no threshold."""

    gate: Float[Leaf, ""]
    opens: Int[Leaf, ""]
    huber: Float[Leaf, ""]


class GuardedPosterior(NamedTuple):
    """A filter's posterior, and the number of samples of each channel that were rejected in a row."""

    mean: Float[Array, " joint"]
    P: Float[Array, "joint joint"]
    tick: Int[Array, ""]
    rejections: Int[Array, " q"]


AnyPosterior = Posterior | GuardedPosterior  # a filter's state after a sample


def make_guard(gate: float | None, opens: int, huber: float | None) -> PyTree:
    """Return the thresholds, or () without any."""
    if gate is None and huber is None:
        return ()
    return Guard(*(np.asarray(np.inf if threshold is None else threshold) for threshold in (gate, opens, huber)))


def initial_posterior(first: Posterior, guard: PyTree, outputs: int) -> AnyPosterior:
    """Return the state before the first sample."""
    return GuardedPosterior(*first, jnp.zeros(outputs, int)) if isinstance(guard, Guard) else first


def new_posterior(before: AnyPosterior, mean: Array, P: Array, tick: Array, rejections: PyTree) -> AnyPosterior:
    """Return the state after a sample, of the same type as `before`."""
    if isinstance(before, GuardedPosterior):
        return GuardedPosterior(mean, P, tick, rejections)
    return Posterior(mean, P, tick)


def rejections(posterior: AnyPosterior) -> PyTree:
    """Return the number of samples of each channel that were rejected in a row [q], or () without thresholds."""
    return posterior.rejections if isinstance(posterior, GuardedPosterior) else ()


def weigh(guard: PyTree, count: PyTree, nu: Array, s: Array, r: Array, mask: Array) -> tuple[Array, Array, PyTree]:
    """Return whether a channel is used, the variance of its noise for the update, and how many were rejected in a row.

    `count` is the number before, or () without thresholds.
    """
    if not isinstance(guard, Guard):
        return mask, r, ()
    z = jnp.abs(nu) / jnp.sqrt(s)
    is_rejected = mask & (z > guard.gate) & (count < guard.opens)
    new_count = jnp.where(is_rejected, count + 1, jnp.where(mask, 0, count))
    return mask & ~is_rejected, r + s * (jnp.maximum(z / guard.huber, 1.0) - 1.0), new_count
