"""Fewer directions with the same covariance: an orthogonal change of the unit normals that leaves the last ones without effect.

Householder reflections from the right, each of which gathers the row that has most left (relative to its size, so that units do
not matter) in one column: B B' is unchanged, and past the rank of B every column is rounding. Source: Businger, Golub, Numer.
Math. 7 (1965), 269: QR with pivoting, here of B'.
"""

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int

NEGLIGIBLE = 1e-13  # of a row's size: a column that is smaller in every row is rounding


def compressed(
    B: Float[Array, "S r C"], keep: int
) -> tuple[Float[Array, "S r C"], Int[Array, " C"], Float[Array, " C"]]:
    """Return directions of the same covariance, how many are left, and what was lost where `keep` columns are too few.

    The loss is the largest part of a row's size that was in a column that had to go. S numbers of the joint state, C cells.
    """
    size = jnp.sum(B * B, 1)
    B = jnp.where(jnp.isfinite(size)[:, None], B, 0.0)  # what has grown beyond all bounds must not spoil the rest
    size = jnp.where(jnp.isfinite(size), size, 0.0)
    weight = jnp.where(size > 0, 1 / jnp.where(size > 0, size, 1.0), 0.0)
    column = jnp.arange(B.shape[1])[:, None]

    def left(j: Array, B: Array) -> Array:
        return jnp.where(column[None] >= j, B, 0.0)

    def some(c: tuple[Array, Array]) -> Array:
        rest = left(*c)
        return (c[0] < B.shape[1]) & jnp.any(jnp.sum(rest * rest, 1) * weight > NEGLIGIBLE**2)

    def reflect(c: tuple[Array, Array]) -> tuple[Array, Array]:
        j, B = c
        rest = left(j, B)
        row = jnp.argmax(jnp.sum(rest * rest, 1) * weight, 0)
        v = jnp.take_along_axis(rest, row[None, None], 0)[0]
        length = jnp.sqrt(jnp.sum(v * v, 0))
        u = v + jnp.where(column == j, jnp.where(v[j] < 0, -length, length)[None], 0.0)
        square = jnp.sum(u * u, 0)
        half = jnp.where(square > 0, 2 / jnp.where(square > 0, square, 1.0), 0.0)
        return j + 1, B - (jnp.sum(B * u[None], 1) * half[None])[:, None] * u[None]

    _, B = lax.while_loop(some, reflect, (jnp.asarray(0), B))
    parts = jnp.sqrt(jnp.max(B * B * weight[:, None], 0))
    rank = jnp.sum(parts > NEGLIGIBLE, 0)
    lost = jnp.max(jnp.where(column >= keep, parts, 0.0), 0, initial=0.0)
    stays = jnp.minimum(rank, keep)
    return jnp.where((column < stays[None])[None], B, 0.0), stays, jnp.where(rank > keep, lost, 0.0)
