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

from pcbench.engine import lane_array
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.products.affine_detection import PLANT, Form, Z, one_lane, slopes, steady
from pcbench.engine.products.blocks import TICKS, Chunks
from pcbench.engine.products.qr_sums import Basis, basis
from pcbench.simulation.problem import Layout, Problem, State


class Maps(NamedTuple):
    """C chunks; z has r numbers of each lane's own and S shared ones, of which r' and S' move (an observer's: not x)."""

    own: Array  # [C, TICKS n, r] what each own number adds to the errors
    common: Array  # [C, TICKS n, 1 + S] what is the same in all lanes, and what shared numbers add
    basis: Basis  # the QR of `own`, by which squares are summed
    own_after: Array  # [C, r', r] the same of own numbers behind the chunk
    common_after: Array  # [C, r', 1 + S]
    shared_after: Array  # [C, S', 1 + S] and of shared ones


class Moving(NamedTuple):
    """What is moved of a plant, or of an observer's memory: r own numbers of each lane, S shared ones."""

    own: Array  # [r, L]; where no lane has its own, [0, 1]
    shared: Array  # [S]


class Columns(NamedTuple):
    """What M chunks do to some columns: to z = 0, and to directions of z; F numbers."""

    errors: Array  # [M, TICKS n, columns]
    after: Array  # [M, F, columns]


def maps(layout: Layout, p: Problem, state: State, form: Form, each: Chunks) -> Maps:
    """Return the maps of one form."""
    _, shapes = one_lane(state, form.label)
    order = [*form.own, *form.shared]
    sizes = [math.prod(shapes[i].shape) for i in order]
    F, r = sum(sizes), sum(sizes[: len(form.own)])
    same = steady(layout, p, state, form)
    once = 1 + np.flatnonzero(np.repeat([i in same for i in order], sizes))
    moving, carried = np.setdiff1d(np.arange(1 + F), once), partial(_columns, layout, p, state, form)
    found = carried(moving, each)
    if len(once):  # of every length; so many that they fill vectors
        lengths = Chunks(jnp.zeros(2 * TICKS, int), jnp.minimum(jnp.arange(2 * TICKS), TICKS), each.before)
        back, steadily = np.argsort(np.r_[moving, once]), carried(once, lengths)
        both = zip(found, steadily, strict=True)
        found = Columns(*(jnp.concatenate([a, b[each.length]], -1)[..., back] for a, b in both))
    errors, after = found
    moves = np.repeat([i != 0 or form.label == PLANT for i in order], sizes)
    own, shared, common = np.flatnonzero(moves[:r]), r + np.flatnonzero(moves[r:]), np.r_[0, 1 + r : 1 + F]
    return Maps(
        own=errors[..., 1 : 1 + r],
        common=errors[..., common],
        basis=basis(errors[..., 1 : 1 + r], form.signals),
        own_after=after[:, own, 1 : 1 + r],
        common_after=after[:, own][..., common],
        shared_after=after[:, shared][..., common],
    )


def _columns(layout: Layout, p: Problem, state: State, form: Form, which: np.ndarray, each: Chunks) -> Columns:
    """Return what chunks do to some columns: the first is of z = 0, the others are directions."""
    tree, shapes = one_lane(state, form.label)
    order, many, C = [*form.own, *form.shared], len(which), each.start.shape[0]
    sizes = [math.prod(shapes[i].shape) for i in order]
    F = sum(sizes)
    zeros = [jnp.zeros(a.shape, a.dtype) for a in shapes]  # what no error depends on may be anything

    def column(k: Array, first: Array, z: Z) -> tuple[Array, Z]:
        (e, after), (de, dz) = slopes(layout, p, form.label, tree, k, zeros, z)
        return de + jnp.where(first, e, 0.0), {i: dz[i] + jnp.where(first, after[i], 0.0) for i in z}

    parts = jnp.split(jnp.tile(jnp.eye(F, 1 + F, 1)[:, which], C), np.cumsum(sizes)[:-1])
    start = {i: lane_array.split(a.reshape(*shapes[i].shape, a.shape[-1])) for i, a in zip(order, parts, strict=True)}
    e, z = _carried(column, form.signals, start, each, jnp.asarray(which == 0))
    after = jnp.concatenate([lane_array.join(z[i]).reshape(-1, C, many) for i in order])
    return Columns(jnp.moveaxis(e.reshape(-1, C, many), 1, 0), jnp.moveaxis(after, 1, 0))


def _carried(column: Any, signals: int, z: Z, each: Chunks, first: Array) -> tuple[Array, Z]:
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
