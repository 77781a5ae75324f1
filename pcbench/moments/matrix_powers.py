"""Some ticks in a row without an event: powers of a tick's matrix move covariances over all of them at once.

With z what noise reaches, s what is seen of it at a tick and w the noise of a tick, the matrix of a tick is that of
(z, w) -> (z+, s). Where it is the same at every tick, z after j ticks is F_j z and noise of covariance Q_j, and what is seen
then is E_j z and noise of covariance R_j.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from pcbench.moments.covariance import WRITTEN_OUT, product, squared, turned


class Powers(NamedTuple):
    """What a tick's matrix makes of J ticks in a row."""

    moved: Float[Array, "J A A C"]  # F_1 .. F_J
    pushed: Float[Array, "J A A C"]  # Q_1 .. Q_J
    seen: Float[Array, "J V A C"]  # E_0 .. E_(J-1)
    noise: Float[Array, "J V X C"]  # R_0 .. R_(J-1): X is V where it is to be joint, 1 where variances alone are


def powers(matrix: Array, A: int, ticks: int, joint: bool) -> Powers:
    """Return what a tick's matrix [A + V, A + w, C] makes of 1 to so many ticks."""
    S, N = matrix[:, :A], matrix[:, A:]
    direct = squared(N[A:]) if joint else jnp.sum(N[A:] ** 2, 1)[:, None]
    one = Powers(S[:A], squared(N[:A]), S[A:], direct)

    def following(F: Array, Q: Array) -> Powers:
        seen = product(S[A:], Q)
        noise = product(seen, turned(S[A:])) if joint else jnp.sum(seen * S[A:], 1)[:, None]
        moved, pushed = product(one.moved, F), product(product(one.moved, Q), turned(one.moved)) + one.pushed
        return Powers(moved, pushed, product(S[A:], F), noise + direct)

    def another(last: Powers, _: None) -> tuple[Powers, Powers]:
        new = following(last.moved, last.pushed)
        return new, new

    first = jax.tree.map(lambda a: a[None], one)
    if ticks == 1:
        return first
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), first, lax.scan(another, one, None, ticks - 1)[1])


def covariances(by: Powers, P: Float[Array, "D D C"], joint: bool) -> Array:
    """Return those of what is seen at ticks 0 .. J - 1: `joint` [J, V, V, C], or variances alone [J, V, 1, C]."""
    J, V, A, cells = by.seen.shape
    E, P = by.seen, P[:A, :A]
    if not joint and A <= WRITTEN_OUT:
        return sum((_row(E, P[None, None, None], a) for a in range(A)), by.noise)
    X = product(E.reshape(J * V, A, cells), P).reshape(E.shape)
    return (jax.vmap(lambda x, e: product(x, turned(e)))(X, E) if joint else jnp.sum(X * E, 2)[:, :, None]) + by.noise


def _row(E: Array, P: Array, a: int) -> Array:
    """What a covariance's row up to the diagonal adds to variances [J, V, 1, C]: those beyond it are the same again."""
    before = (2 * P[..., a, b, :] * E[:, :, b, None] for b in range(a))
    return E[:, :, a, None] * sum(before, P[..., a, a, :] * E[:, :, a, None])


def after(by: Powers, ticks: Array, P: Float[Array, "D D C"]) -> Float[Array, "D D C"]:
    """Return the covariance after 1 to J ticks; what is on the network, beyond the first A numbers, stays as it is."""
    F, Q = by.moved[ticks - 1], by.pushed[ticks - 1]
    A = len(F)
    X = product(F, P[:A])
    moved = product(X[:, :A], turned(F)) + Q
    if len(P) == A:
        return moved
    return P.at[:A, :A].set(moved).at[:A, A:].set(X[:, A:]).at[A:, :A].set(turned(X[:, A:]))


def seen_of(by: Powers, z: Float[Array, "P D C"]) -> Float[Array, "J P V C"]:
    """Return what is seen of vectors at ticks 0 .. J - 1."""
    J, V, A, cells = by.seen.shape
    each = jax.vmap(lambda d: product(by.seen.reshape(J * V, A, cells), d[:A, None])[:, 0])(z)
    return jnp.moveaxis(each.reshape(len(z), J, V, cells), 1, 0)


def later(by: Powers, ticks: Array, z: Float[Array, "P D C"]) -> Float[Array, "P D C"]:
    """Return vectors after 1 to J ticks."""
    F = by.moved[ticks - 1]
    A = len(F)
    return z.at[:, :A].set(jax.vmap(lambda d: product(F, d[:A, None])[:, 0])(z))
