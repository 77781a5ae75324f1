"""The product of every chunk: from z at its first tick to the errors at each of its ticks, and to z behind its last.

    e_(k+t) = a_t + E_t z_k,   z_(k+len) = b + A z_k;   a_t and E_t of a tick beyond the chunk's end are 0

The columns are carried through the observer's and the plant's own functions, all chunks at once: what comes of z = 0, and the
derivative along each number of z.
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.simulation import lanes
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.lifted.chunks import TICKS, Chunks
from pcbench.simulation.lifted.form import Form, motion, one_lane, tangents
from pcbench.simulation.problem import Layout, Problem, State

Z = dict[int, Any]  # leaves of z by number, own ones first


class Maps(NamedTuple):
    """Of one observer and C chunks, n signals; z has r numbers of each lane's own and S shared ones."""

    own: Array  # [C, TICKS n, r] what each number of a lane adds to the errors
    common: Array  # [C, TICKS n, 1 + S] what is the same in all lanes, and what shared numbers add
    own_after: Array  # [C, r, r] the same of a lane's numbers behind the chunk
    common_after: Array  # [C, r, 1 + S]
    shared_after: Array  # [C, S, 1 + S] and of the shared ones


def maps(layout: Layout, p: Problem, state: State, form: Form, each: Chunks) -> Maps:
    """Return the products of one observer."""
    tree, shapes = one_lane(state, form.label)
    rest = [jnp.zeros(a.shape, a.dtype) for a in shapes]  # what no error depends on may be anything
    order, sizes = [*form.own, *form.shared], [math.prod(shapes[i].shape) for i in (*form.own, *form.shared)]

    def affine(k: Array, z: Z) -> tuple[Array, Z]:
        e, after = motion(layout, p, form.label, tree, k, [z.get(i, a) for i, a in enumerate(rest)])
        return e, {i: after[i] for i in z}

    def linear(k: Array, z: Z) -> tuple[Array, Z]:
        return tangents(layout, p, form.label, tree, k, rest, z)

    def start(rows: Array) -> Z:  # [F, lanes] -> z
        parts = jnp.split(rows, np.cumsum(sizes)[:-1]) if sizes else []
        return {i: lanes.split(a.reshape(*shapes[i].shape, -1)) for i, a in zip(order, parts, strict=True)}

    F, C = sum(sizes), each.start.shape[0]
    e, z = _carried(affine, form.signals, start(jnp.zeros((F, C))), each, 1)
    de, dz = _carried(linear, form.signals, start(jnp.tile(jnp.eye(F), C)), each, F)

    def numbers(z: Z, many: int) -> Array:
        return jnp.concatenate([jnp.zeros((0, C, many)), *(lanes.join(z[i]).reshape(-1, C, many) for i in order)])

    errors = [jnp.moveaxis(a.reshape(TICKS * form.signals, C, -1), 1, 0) for a in (e, de)]  # [C, TICKS n, 1 or F]
    after = [jnp.moveaxis(a, 1, 0) for a in (numbers(z, 1), numbers(dz, F))]  # [C, F, 1 or F]
    r = sum(sizes[: len(form.own)])
    return Maps(
        own=errors[1][..., :r],
        common=jnp.concatenate([errors[0], errors[1][..., r:]], -1),
        own_after=after[1][:, :r, :r],
        common_after=jnp.concatenate([after[0], after[1][..., r:]], -1)[:, :r],
        shared_after=jnp.concatenate([after[0], after[1][..., r:]], -1)[:, r:],
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
        return lanes.like(after, z, width), lax.dynamic_update_index_in_dim(table, lanes.join(e), t, 0)

    z, e = lax.fori_loop(0, jnp.max(each.length), tick, (z, jnp.zeros((TICKS, signals, width))))
    return e, z
