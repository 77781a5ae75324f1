"""Sums of squares over a chunk without its ticks: the QR of what a lane's own numbers add to the errors.

    e_t = a_t + E_t z,  E = Q R,  a = Q c + d with d orthogonal to Q:   sum of e_t^2 = |R z + c|^2 + |d|^2

By the modified method of Gram and Schmidt, to a as to a further column of E: R, c and d are then as accurate as those of
reflections (Bjorck 1967), and the sum as accurate as that over ticks, as R z + c is rounded as errors are. LAPACK is not
called: from a program that was kept it waits for Python, and Python for it.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from pcbench.engine.products import matmul
from pcbench.engine.products.blocks import TICKS


class Basis(NamedTuple):
    """Of C chunks and n signals; r own numbers of a lane."""

    Q: Array  # [C, n, r, TICKS] columns that are orthogonal, each of length one or zero
    R: Array  # [C, n, r, r] 0 below its diagonal


def basis(E: Array, signals: int) -> Basis:
    """Return the QR of each chunk's and signal's rows of E [C, TICKS n, r]: for all chunks at once."""
    chunks, r = len(E), E.shape[-1]
    rows = jnp.moveaxis(E.reshape(chunks, TICKS, signals, r), (1, 3), (0, 1)).reshape(TICKS, r, chunks * signals)

    def column(V: Array, j: Array) -> tuple[Array, tuple[Array, Array]]:
        v = lax.dynamic_index_in_dim(V, j, 1, keepdims=False)
        size = jnp.sqrt(jnp.sum(v * v, 0, keepdims=True))
        q = v / jnp.where(size > 0, size, 1.0)
        row = jnp.where(jnp.arange(r)[:, None] < j, 0.0, jnp.sum(q[:, None] * V, 0))
        return V - q[:, None] * row[None], (q, row)

    if not r:
        return Basis(jnp.zeros((chunks, signals, 0, TICKS)), jnp.zeros((chunks, signals, 0, 0)))
    _, (Q, R) = lax.scan(column, rows, jnp.arange(r))  # [r, TICKS, C n] and [r, r, C n]
    return Basis(*(jnp.moveaxis(a, 2, 0).reshape(chunks, signals, r, a.shape[1]) for a in (Q, R)))


def parts(Q: Array, a: Array) -> tuple[Array, Array]:
    """Return of a [n, TICKS] the part along Q [n, r, TICKS], c [n, r], and the sum of squares of the rest, [n]."""

    def less(a: Array, q: Array) -> tuple[Array, Array]:
        c = jnp.sum(q * a, 1)
        return a - q * c[:, None], c

    rest, c = lax.scan(less, a, jnp.moveaxis(Q, 1, 0), unroll=matmul.few(Q.shape[1]))
    return c.T, jnp.sum(rest * rest, 1)


def square(R: Array, along: Array, beside: Array, own: Array) -> Array:
    """Return |R z + along|^2 + beside for the own numbers z [r, L] of every lane, [n, L]; of one chunk."""
    n, r = along.shape
    if not matmul.few(r):
        mixed = matmul.of_lanes(R.reshape(n * r, r), along.ravel(), own).reshape(n, r, -1)
        return beside[:, None] + jnp.sum(mixed * mixed, 1)
    each = (matmul.of_lanes(R[:, k, k:], along[:, k], own[k:]) for k in range(r))
    return reduce(jnp.add, (row * row for row in each), beside[:, None])
