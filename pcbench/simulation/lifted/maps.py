"""The product of every chunk: from z at its first tick to the errors at each of its ticks, and to z behind its last.

    [e_k, ..., e_(k+7), z_(k+len)] = M [1, z_k],     M [7 n + n + F, 1 + F], rows of ticks beyond the chunk's end are 0

The columns are carried through the observer's and the plant's own functions, all chunks at once: what comes of z = 0, and the
derivative along each number of z.
"""

import math
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.lifted.chunks import TICKS, Chunks
from pcbench.simulation.lifted.form import Form, motion, one_lane, tangents
from pcbench.simulation.problem import Layout, Problem, State

Z = dict[int, Any]  # leaves of z by number, own ones first


def maps(layout: Layout, p: Problem, state: State, form: Form, each: Chunks) -> Array:
    """Return M [C, TICKS n + F, 1 + F] of one observer; numbers of z in the order own, shared."""
    tree, shapes = one_lane(state, form.label)
    rest = [jnp.zeros(a.shape, a.dtype) for a in shapes]  # what no error depends on may be anything
    order, sizes = [*form.own, *form.shared], [math.prod(shapes[i].shape) for i in (*form.own, *form.shared)]

    def affine(k: Array, z: Z) -> tuple[Array, Z]:
        e, after = motion(layout, p, form.label, tree, k, [z.get(i, a) for i, a in enumerate(rest)])
        return e, {i: after[i] for i in z}

    def linear(k: Array, z: Z) -> tuple[Array, Z]:
        return tangents(layout, p, form.label, tree, k, rest, z)

    def start(rows: Array) -> Z:  # [F, lanes] -> z
        parts = jnp.split(rows, [sum(sizes[: i + 1]) for i in range(len(sizes) - 1)]) if sizes else []
        return {i: lanes.split(a.reshape(*shapes[i].shape, -1)) for i, a in zip(order, parts, strict=True)}

    F, C = sum(sizes), each.start.shape[0]
    e, z = _carried(affine, start(jnp.zeros((F, C))), each, 1)
    de, dz = _carried(linear, start(jnp.tile(jnp.eye(F), C)), each, F)

    def numbers(z: Z, many: int) -> Array:
        return jnp.concatenate([lanes.join(z[i]).reshape(-1, C, many) for i in order])

    errors = jnp.concatenate([e.reshape(-1, C, 1), de.reshape(-1, C, F)], -1)  # [TICKS n, C, 1 + F]
    after = jnp.concatenate([numbers(z, 1), numbers(dz, F)], -1)  # [F, C, 1 + F]
    return jnp.moveaxis(jnp.concatenate([errors, after]), 1, 0)


def _carried(f: Any, z: Z, each: Chunks, columns: int) -> tuple[Array, Z]:
    """Carry columns of every chunk through its ticks: e [TICKS, n, C columns] and z behind the last."""
    start, length = jnp.repeat(each.start, columns), jnp.repeat(each.length, columns)
    width = start.shape[0]

    def one_tick(k: Array, goes_on: Array, z: Z) -> tuple[Array, Z]:
        e, after = f(k, z)
        return jnp.where(goes_on, e, 0.0), {i: jnp.where(goes_on, after[i], a) for i, a in z.items()}

    def tick(z: Z, t: Array) -> tuple[Z, Array]:
        k, goes_on = lanes.split(start + t), lanes.split(t < length)
        e, after = over(one_tick)(k, goes_on, z)
        return lanes.like(after, z, width), lanes.join(lanes.like(e, lanes.spread(jnp.zeros(e.shape), width), width))

    z, e = lax.scan(tick, z, jnp.arange(TICKS))
    return e, z

