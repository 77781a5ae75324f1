"""What a chunk does to its lanes, all chunks at once: numbers that the lanes of a cell have in common.

    e_(k+t) = a_t + E_t z_k,   z_(k+len) = b + A z_k;   a_t and E_t of a tick beyond the chunk's end are 0

They are carried through the observer's and the plant's own functions: what comes of z = 0, and the derivative along each
number of z. An observer's z has the plant's x in it, whose own A and b are the plant's alone.
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.simulation import lanes
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.lifted.chunks import TICKS, Chunks
from pcbench.simulation.lifted.form import PLANT, Form, Z, one_lane, slopes
from pcbench.simulation.problem import Layout, Problem, State


class Maps(NamedTuple):
    """C chunks; z has r numbers of each lane's own and S shared ones, of which r' and S' move (an observer's: not x)."""

    own: Array  # [C, TICKS n, r] what each own number adds to the errors
    common: Array  # [C, TICKS n, 1 + S] what is the same in all lanes, and what shared numbers add
    own_root: Array  # [C, n, r, r] R of the QR of a signal's map: its sum of squares is |R (z, 1, shared)|^2
    common_root: Array  # [C, n, F, 1 + S]; of F = r + 1 + S rows the first r depend on a lane's own numbers
    own_after: Array  # [C, r', r] the same of own numbers behind the chunk
    common_after: Array  # [C, r', 1 + S]
    shared_after: Array  # [C, S', 1 + S] and of shared ones


class Moving(NamedTuple):
    """What is moved of a plant, or of an observer's memory: r own numbers of each lane, S shared ones."""

    own: Array  # [r, L]; where no lane has its own, [0, 1]
    shared: Array  # [S]


def maps(layout: Layout, p: Problem, state: State, form: Form, each: Chunks) -> Maps:
    """Return the maps of one form."""
    tree, shapes = one_lane(state, form.label)
    order = [*form.own, *form.shared]
    sizes = [math.prod(shapes[i].shape) for i in order]
    F, C, r = sum(sizes), each.start.shape[0], sum(sizes[: len(form.own)])
    zeros = [jnp.zeros(a.shape, a.dtype) for a in shapes]  # what no error depends on may be anything

    def column(k: Array, first: Array, z: Z) -> tuple[Array, Z]:
        (e, after), (de, dz) = slopes(layout, p, form.label, tree, k, zeros, z)
        return de + jnp.where(first, e, 0.0), {i: dz[i] + jnp.where(first, after[i], 0.0) for i in z}

    parts = jnp.split(jnp.tile(jnp.eye(F, 1 + F, 1), C), np.cumsum(sizes)[:-1])
    start = {i: lanes.split(a.reshape(*shapes[i].shape, -1)) for i, a in zip(order, parts, strict=True)}
    e, z = _carried(column, form.signals, start, each, 1 + F)
    errors = jnp.moveaxis(e.reshape(-1, C, 1 + F), 1, 0)  # [C, TICKS n, 1 + F]
    after = jnp.moveaxis(jnp.concatenate([lanes.join(z[i]).reshape(-1, C, 1 + F) for i in order]), 1, 0)
    moves = np.repeat([i != 0 or form.label == PLANT for i in order], sizes)
    own, shared = np.flatnonzero(moves[:r]), r + np.flatnonzero(moves[r:])
    common = np.r_[0, 1 + r : 1 + F]
    root = roots(jnp.concatenate([errors[..., 1 : 1 + r], errors[..., common]], -1), form.signals)
    return Maps(
        own=errors[..., 1 : 1 + r],
        common=errors[..., common],
        own_root=root[:, :, :r, :r],
        common_root=root[..., r:],
        own_after=after[:, own, 1 : 1 + r],
        common_after=after[:, own][..., common],
        shared_after=after[:, shared][..., common],
    )


def roots(E: Array, signals: int) -> Array:
    """Return R of each chunk's and signal's rows, [C, TICKS n, F] to [C, n, F, F]: rows = Q R, R 0 below its diagonal.

    By the modified method of Gram and Schmidt, whose R is as accurate as that of reflections (Bjorck 1967), for all chunks at
    once. LAPACK is not called: from a program that was kept it waits for Python, and Python for it.
    """
    chunks, F = len(E), E.shape[-1]
    rows = jnp.moveaxis(E.reshape(chunks, TICKS, signals, F), (1, 3), (0, 1)).reshape(TICKS, F, chunks * signals)

    def column(V: Array, j: Array) -> tuple[Array, Array]:
        v = lax.dynamic_index_in_dim(V, j, 1, keepdims=False)
        size = jnp.sqrt(jnp.sum(v * v, 0, keepdims=True))
        q = v / jnp.where(size > 0, size, 1.0)
        row = jnp.where(jnp.arange(F)[:, None] < j, 0.0, jnp.sum(q[:, None] * V, 0))
        return V - q[:, None] * row[None], row

    _, R = lax.scan(column, rows, jnp.arange(F))  # [F, F, C n]
    return jnp.moveaxis(R, 2, 0).reshape(chunks, signals, F, F)


def _carried(column: Any, signals: int, z: Z, each: Chunks, columns: int) -> tuple[Array, Z]:
    """Carry columns of every chunk through its ticks: e [TICKS, n, C columns], 0 beyond a chunk's end, and z behind it.

    The first column is of z = 0, the others are directions.
    """
    start, length = jnp.repeat(each.start, columns), jnp.repeat(each.length, columns)
    width = start.shape[0]
    first = lanes.split(jnp.arange(width) % columns == 0)

    def one_tick(k: Array, goes_on: Array, first: Array, z: Z) -> tuple[Array, Z]:
        e, after = column(k, first, z)
        return jnp.where(goes_on, e, 0.0), {i: jnp.where(goes_on, after[i], a) for i, a in z.items()}

    def tick(t: Array, carried: tuple[Z, Array]) -> tuple[Z, Array]:
        z, table = carried
        e, after = over(one_tick)(lanes.split(start + t), lanes.split(t < length), first, z)
        if signals:
            table = lax.dynamic_update_index_in_dim(table, lanes.join(e), t, 0)
        return lanes.like(after, z, width), table

    z, e = lax.fori_loop(0, jnp.max(each.length), tick, (z, jnp.zeros((TICKS, signals, width))))
    return e, z
