"""Does what noise reaches decide how it moves on? A look at a tick and at an arrival, which are traced and not run.

Where the slope of a tick reads the state that it is taken at, an observer is hardly affine. Whether it is, one realisation of a
cell says, so that the others are not gone through for nothing. Too much may be found here, as where a limit is never met, but
hardly too little.
"""

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.engine.products.affine_detection import reach
from pcbench.moments.events import jump, sense
from pcbench.moments.inputs import begin
from pcbench.moments.noise_state import OneCell, form_of, slope, vector
from pcbench.moments.tick_matrix import flat, one_cell
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout


def curved(layout: Layout, problem: GridPointParams) -> bool:
    """Return whether in an open loop a slope may depend on what noise reaches."""
    if layout.controller:
        return False
    leaves, tree = jax.tree.flatten(problem._replace(schedule=(), weights=()))
    return _curved(layout, tree, tuple((np.shape(a), np.result_type(a)) for a in leaves))


@lru_cache(64)
def _curved(layout: Layout, tree: Any, shapes: tuple[Any, ...]) -> bool:
    p = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(*each) for each in shapes])
    form = form_of(layout, p)
    if not any(form.moving):
        return False
    zero, n, q = jnp.asarray(0), p.x0.shape[0], p.noise_std.shape[0]
    state = jax.eval_shape(lambda p: begin(layout, p, zero, (), jnp.zeros(2 * n), ()), p)
    packet = jax.eval_shape(lambda p, state: sense(layout, p, zero, state, (), ()), p, state)
    row = ArrivalInfo(jnp.ones(q, bool), jnp.zeros(q, int), jnp.zeros(q, int), zero)

    def read(f: OneCell, flat: Any, entering: Any, rest: Any) -> bool:
        def matrix(state: Any, p: Any, k: Any, entering: Any) -> Any:
            return slope(form, f, flat)(p, k, state, entering, rest)

        found, _ = reach(matrix, state, p, zero, entering)
        return any(moves and leaf in found for leaf, moves in enumerate(form.moving))

    process = jax.ShapeDtypeStruct(p.process_std.shape, float)
    return read(partial(one_cell, layout), partial(flat, form), process, ()) or read(
        partial(jump, layout), partial(vector, form), packet, (jnp.asarray(True), row)
    )
