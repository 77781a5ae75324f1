"""Whether an observer asks when the last arrival was (`ticks_since_arrival`): a look at its jump, which is traced and not run.

Where it does, what it makes of an arrival depends on which sample came before, on losses too.
"""

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.moments.inputs import begin
from pcbench.protocols import Arrival
from pcbench.simulation import simulate_runs
from pcbench.simulation.types import GridPointParams, Layout


def asked(layout: Layout, problem: GridPointParams) -> bool:
    """Return whether an observer may ask how long ago the last arrival was."""
    leaves, tree = jax.tree.flatten(problem._replace(schedule=(), weights=()))
    return _asks(layout, tree, tuple((np.shape(a), np.result_type(a)) for a in leaves))


@lru_cache(64)
def _asks(layout: Layout, tree: Any, shapes: tuple[Any, ...]) -> bool:
    p = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(*each) for each in shapes])
    zero, n, q = jnp.asarray(0), p.x0.shape[0], p.noise_std.shape[0]
    run = jax.eval_shape(lambda p: begin(layout, p, zero, (), jnp.zeros(2 * n), ()), p)
    notes = jax.eval_shape(lambda p, r: simulate_runs.take_notes(layout, p, zero, r.memories, r.commands), p, run)

    def jump(since: Any, p: Any, run: Any, notes: Any) -> Any:
        none = jnp.zeros(q, int)
        arrival = partial(Arrival, jnp.zeros(q), jnp.ones(q, bool), none, none, ticks_since_arrival=since)
        return simulate_runs.jump(layout, p, zero, run, notes, arrival)

    made = jax.make_jaxpr(jump)(zero, p, run, notes).jaxpr
    mine = made.invars[0]
    return any(v is mine for v in [*made.outvars, *(v for e in made.eqns for v in e.invars)])
