"""What a chunk does to its lanes, all chunks at once: numbers that the lanes of a cell have in common.

    e_(k+t) = a_t + E_t z_k,   z_(k+len) = b + A z_k;   a_t and E_t of a tick beyond the chunk's end are 0

They are carried through the observer's and the plant's own functions: what comes of z = 0, and the derivative along each
number of z. An observer's z has the plant's x in it, whose own A and b are the plant's alone.
"""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.engine import lane_array
from pcbench.engine.initial_state import begin
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.products.affine_detection import PLANT, Form, Z, forms, one_lane, slopes
from pcbench.engine.products.matmul import TICKS, Chunks, chunks
from pcbench.simulation.types import GridPointParams, Layout, State


class Maps(NamedTuple):
    """C chunks; z has r numbers of each lane's own and S shared ones, of which r' and S' move (an observer's: not x)."""

    own: Array  # [C, TICKS n, r] what each own number adds to the errors
    common: Array  # [C, TICKS n, 1 + S] what is the same in all lanes, and what shared numbers add
    own_after: Array  # [C, r', r] the same of own numbers behind the chunk
    common_after: Array  # [C, r', 1 + S]
    shared_after: Array  # [C, S', 1 + S] and of shared ones


class Moving(NamedTuple):
    """What is moved of a plant, or of an observer's memory: r own numbers of each lane, S shared ones."""

    own: Array  # [r, L]; where no lane has its own, [0, 1]
    shared: Array  # [S]


def every_map(layout: Layout, p: GridPointParams) -> dict[str, Maps]:
    """Return by label the maps of the plant and of every observer that goes by products; none where nothing does."""
    if not layout.lifted:
        return {}
    layout = layout._replace(width=1, ring=1)  # no map depends on them
    state = jax.eval_shape(partial(begin, layout), p, jnp.asarray(0), jnp.zeros(1, int))
    each = chunks(p, layout.lifted)
    return {form.label: maps(layout, p, state, form, each) for form in forms(layout, p, state)}


def maps(layout: Layout, p: GridPointParams, state: State, form: Form, each: Chunks) -> Maps:
    """Return the maps of one form: of z = 0, and of a direction along each number of z."""
    tree, shapes = one_lane(state, form.label)
    order, C = [*form.own, *form.shared], each.start.shape[0]
    sizes = [math.prod(shapes[i].shape) for i in order]
    F, r = sum(sizes), sum(sizes[: len(form.own)])
    zeros = [jnp.zeros(a.shape, a.dtype) for a in shapes]  # what no error depends on may be anything

    def column(k: Array, first: Array, z: Z) -> tuple[Array, Z]:
        (e, after), (de, dz) = slopes(layout, p, form.label, tree, k, zeros, z)
        return de + jnp.where(first, e, 0.0), {i: dz[i] + jnp.where(first, after[i], 0.0) for i in z}

    parts = jnp.split(jnp.tile(jnp.eye(F, 1 + F, 1), C), np.cumsum(sizes)[:-1])
    start = {i: lane_array.split(a.reshape(*shapes[i].shape, a.shape[-1])) for i, a in zip(order, parts, strict=True)}
    e, z = _propagate_columns(column, form.signals, start, each, jnp.arange(1 + F) == 0)
    errors = jnp.moveaxis(e.reshape(-1, C, 1 + F), 1, 0)
    after = jnp.concatenate([lane_array.join(z[i]).reshape(-1, C, 1 + F) for i in order])
    after = jnp.moveaxis(after, 1, 0)
    moves = np.repeat([i != 0 or form.label == PLANT for i in order], sizes)
    own, shared, common = np.flatnonzero(moves[:r]), r + np.flatnonzero(moves[r:]), np.r_[0, 1 + r : 1 + F]
    return Maps(
        own=errors[..., 1 : 1 + r],
        common=errors[..., common],
        own_after=after[:, own, 1 : 1 + r],
        common_after=after[:, own][..., common],
        shared_after=after[:, shared][..., common],
    )


def _propagate_columns(column: PyTree, signals: int, z: Z, each: Chunks, first: Array) -> tuple[Array, Z]:
    """Carry columns of every chunk through its ticks: e [TICKS, n, C columns], 0 beyond a chunk's end, and z behind it.

    The `first` [columns] are of z = 0, the others are directions.
    """
    start, length = jnp.repeat(each.start, len(first)), jnp.repeat(each.length, len(first))
    width = start.shape[0]
    of_zero = lane_array.split(jnp.tile(first, len(each.start)))

    def one_tick(k: Array, goes_on: Array, first: Array, z: Z) -> tuple[Array, Z]:
        e, after = column(k, first, z)
        return jnp.where(goes_on, e, 0.0), {i: jnp.where(goes_on, after[i], a) for i, a in z.items()}

    def tick(t: Array, carried: tuple[Z, Array]) -> tuple[Z, Array]:
        z, table = carried
        e, after = vmap_entrywise(one_tick)(lane_array.split(start + t), lane_array.split(t < length), of_zero, z)
        if signals:
            table = lax.dynamic_update_index_in_dim(table, lane_array.join(e), t, 0)
        return lane_array.match_form(after, z, width), table

    z, e = lax.fori_loop(0, jnp.max(each.length), tick, (z, jnp.zeros((TICKS, signals, width))))
    return e, z
