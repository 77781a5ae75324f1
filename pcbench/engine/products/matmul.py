"""Products of a small matrix with the numbers of every lane, and with those that lanes have in common.

With few numbers a product is written out as sums of products entry by entry: so it is computed in the loop of what uses it, and
nothing is kept between. With many, a product of matrices is as fast, and compiled sooner.
"""

from functools import reduce

import jax.numpy as jnp
from jax import Array

FEW = 10  # own numbers of a lane, at most, that are written out


def same(M: Array, shared: Array) -> Array:
    """Return what is the same in all lanes: M [m, 1 + S] with 1 and the shared numbers [S]."""
    return M @ jnp.append(1.0, shared)


def few(own: int) -> bool:
    """Say whether products with so many numbers of a lane's own are written out."""
    return own <= FEW


def of_lanes(M: Array, fixed: Array, own: Array) -> Array:
    """Return fixed [m] + M [m, r] with the own numbers of every lane [r, L]: [m, L]."""
    if not few(len(own)):
        return jnp.concatenate([fixed[:, None], M], 1) @ jnp.concatenate([jnp.ones((1, own.shape[1])), own])
    return reduce(jnp.add, (M[:, j, None] * own[None, j] for j in range(len(own))), fixed[:, None])
