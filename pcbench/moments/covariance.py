"""Covariances of C cells side by side, and what moves them: small products, the cells on the last axis."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

WRITTEN_OUT = 16  # terms of a sum that are written one by one, which runs fastest; longer ones are compiled as products
Rows = Callable[[Array], Array]  # [D, X, C] -> [D, X, C], linear


def product(M: Float[Array, "i j C"], X: Float[Array, "j k C"]) -> Float[Array, "i k C"]:
    """Return M X, cell by cell."""
    if M.shape[1] > WRITTEN_OUT:
        return jnp.moveaxis(jnp.moveaxis(M, -1, 0) @ jnp.moveaxis(X, -1, 0), 0, -1)
    total = jnp.zeros((M.shape[0], *X.shape[1:]))
    for j in range(M.shape[1]):
        total = total + M[:, j, None] * X[j][None]
    return total


def turned(P: Array) -> Array:
    """Return the transpose of each cell's matrix."""
    return jnp.swapaxes(P, 0, 1)


def squared(G: Float[Array, "D j C"]) -> Float[Array, "D D C"]:
    """Return G G'."""
    return product(G, turned(G))


def both(move: Rows, P: Float[Array, "D D C"]) -> Float[Array, "D D C"]:
    """Return T P T', T what `move` does to rows."""
    return turned(move(turned(move(P))))
