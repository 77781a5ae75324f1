"""The Kalman filter's update by one channel, y = c'x + v with v ~ N(0, r); P of x in Joseph's form, which keeps it >= 0.

    K = P c (c'P c + r)^-1,   x <- x + K (y - c'x),   P <- (I - K c') P (I - K c')' + K r K'

With independent noise one channel after the other is the joint update, and the sum of nu^2 / s over them nu' S^-1 nu.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from pcbench.protocols import InnovationStats


class Posterior(NamedTuple):
    """Mean and covariance at the time of a sample, after it was used."""

    mean: Float[Array, " joint"]  # of the states, of unknowns that are estimated beside them, of a copy of both
    P: Float[Array, "joint joint"]
    taken: Int[Array, ""]  # tick


def gain(Pc: Float[Array, " n"], variance: Float[Array, ""], mask: Bool[Array, ""]) -> Float[Array, " n"]:
    """Return K of a channel whose innovation has this variance; 0 where the channel did not arrive."""
    return jnp.where(mask, Pc / variance, 0.0)


def covariance(
    P: Float[Array, "n n"], K: Float[Array, " n"], c: Float[Array, " n"], r: Float[Array, ""]
) -> Float[Array, "n n"]:
    """Return P after a channel was used with the gain K."""
    keep = jnp.eye(c.shape[0]) - jnp.outer(K, c)
    return keep @ P @ keep.T + r * jnp.outer(K, K)


def with_copy(P: Float[Array, "m m"], n: int) -> Float[Array, "joint joint"]:
    """Return the covariance of the first n of some numbers and of a copy of them."""
    return jnp.tile(P[:n, :n], (2, 2))


def wide(C: Float[Array, "q n"], size: int) -> Float[Array, "q size"]:
    """Return the rows of outputs, or of what is read of a state, where the state has a copy or more beside it."""
    return C if C.shape[1] == size else jnp.pad(C, ((0, 0), (0, size - C.shape[1])))


def unjudged() -> InnovationStats:
    """Return the square of a sample of which nothing has been looked at."""
    return InnovationStats(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()), each=jnp.zeros(0))


def judged(
    so_far: InnovationStats, nu: Float[Array, ""], s: Float[Array, ""], mask: Bool[Array, ""]
) -> InnovationStats:
    """Return the square with the next channel, whose innovation nu has the variance s; of one that is fresh."""
    z = nu / jnp.sqrt(s)
    return InnovationStats(
        nis_sum=so_far.nis_sum + jnp.where(mask, nu * nu / s, 0.0),
        dof=so_far.dof + jnp.where(mask, 1.0, 0.0),
        log_det=so_far.log_det + jnp.where(mask, jnp.log(s), 0.0),
        normalized_sum=so_far.normalized_sum + jnp.where(mask, z, 0.0),
        each=jnp.append(so_far.each, jnp.where(mask, z, jnp.nan)),
    )
