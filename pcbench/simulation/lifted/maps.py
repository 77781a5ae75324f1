"""What a chunk does to its lanes, all chunks at once: numbers that the lanes of a cell have in common.

    e_(k+t) = a_t + E_t z_k,   z_(k+len) = b + A z_k;   a_t and E_t of a tick beyond the chunk's end are 0

They are carried through the observer's and the plant's own functions: what comes of z = 0, and the derivative along each
number of z. An observer's z has the plant's x in it, whose own A and b are the plant's alone.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.simulation import lanes
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.lifted.chunks import TICKS, Chunks
from pcbench.simulation.lifted.form import PLANT, Form, Z, motion, one_lane, tangents
from pcbench.simulation.problem import Layout, Problem, State


class Maps(NamedTuple):
    """C chunks; z has r numbers of each lane's own and S shared ones, of which r' and S' move (an observer's: not x)."""

    own: Array  # [C, TICKS n, r] what each own number adds to the errors
    common: Array  # [C, TICKS n, 1 + S] what is the same in all lanes, and what shared numbers add
    own_after: Array  # [C, r', r] the same of own numbers behind the chunk
    common_after: Array  # [C, r', 1 + S]
    shared_after: Array  # [C, S', 1 + S] and of shared ones


def maps(layout: Layout, p: Problem, state: State, form: Form, each: Chunks) -> Maps:
    """Return the maps of one form."""
    tree, shapes = one_lane(state, form.label)
    rest = [jnp.zeros(a.shape, a.dtype) for a in shapes]  # what no error depends on may be anything
    order = [*form.own, *form.shared]
    sizes = [math.prod(shapes[i].shape) for i in order]
    F, C, r = sum(sizes), each.start.shape[0], sum(sizes[: len(form.own)])

    def affine(k: Array, z: Z) -> tuple[Array, Z]:
        e, after = motion(layout, p, form.label, tree, k, [z.get(i, a) for i, a in enumerate(rest)])
        return e, {i: after[i] for i in z}

    def start(rows: Array) -> Z:  # [F, lanes] -> z
        parts = jnp.split(rows, np.cumsum(sizes)[:-1])
        return {i: lanes.split(a.reshape(*shapes[i].shape, -1)) for i, a in zip(order, parts, strict=True)}

    def by_chunk(found: tuple[Array, Z], columns: int) -> tuple[Array, Array]:  # [C, TICKS n, columns], [C, F, columns]
        e, z = found
        after = jnp.concatenate([lanes.join(z[i]).reshape(-1, C, columns) for i in order])
        return jnp.moveaxis(e.reshape(-1, C, columns), 1, 0), jnp.moveaxis(after, 1, 0)

    linear = partial(tangents, layout, p, form.label, tree)
    a, b = by_chunk(_carried(affine, form.signals, start(jnp.zeros((F, C))), each, 1), 1)
    along = _carried(lambda k, z: linear(k, rest, z), form.signals, start(jnp.tile(jnp.eye(F), C)), each, F)
    E, A = by_chunk(along, F)
    mine = [0 if form.label != PLANT and i == 0 else size for i, size in zip(order, sizes, strict=True)]
    moves = np.repeat([many > 0 for many in mine], sizes)
    own, shared = np.flatnonzero(moves[:r]), r + np.flatnonzero(moves[r:])
    common = jnp.concatenate([b, A[..., r:]], -1)
    return Maps(
        own=E[..., :r],
        common=jnp.concatenate([a, E[..., r:]], -1),
        own_after=A[:, own, :r],
        common_after=common[:, own],
        shared_after=common[:, shared],
    )


def _carried(f: Any, signals: int, z: Z, each: Chunks, columns: int) -> tuple[Array, Z]:
    """Carry columns of every chunk through its ticks: e [TICKS, n, C columns], 0 beyond a chunk's end, and z behind it."""
    start, length = jnp.repeat(each.start, columns), jnp.repeat(each.length, columns)
    width = start.shape[0]

    def one_tick(k: Array, goes_on: Array, z: Z) -> tuple[Array, Z]:
        e, after = f(k, z)
        return jnp.where(goes_on, e, 0.0), {i: jnp.where(goes_on, after[i], a) for i, a in z.items()}

    def tick(t: Array, carried: tuple[Z, Array]) -> tuple[Z, Array]:
        z, table = carried
        e, after = over(one_tick)(lanes.split(start + t), lanes.split(t < length), z)
        if signals:
            table = lax.dynamic_update_index_in_dim(table, lanes.join(e), t, 0)
        return lanes.like(after, z, width), table

    z, e = lax.fori_loop(0, jnp.max(each.length), tick, (z, jnp.zeros((TICKS, signals, width))))
    return e, z
