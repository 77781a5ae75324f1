"""One tick and many: the Runge-Kutta step of a field, and exact powers of a linear map.

Powers: with E_b the map over 2^b ticks (`synthesis.linear.doublings`), any whole age is a product over its bits. The age
may be traced, so one compiled program serves every delay, and no e^{-As} is ever formed.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int

Field = Callable[[Array, Array], Array]  # (t [s], x[n]) -> dx/dt[n]


def rk4(field: Field, t: Array, x: Array, h: Array) -> Array:
    """Advance x by one classical Runge-Kutta step of h seconds from time t."""
    k1 = field(t, x)
    k2 = field(t + h / 2, x + h / 2 * k1)
    k3 = field(t + h / 2, x + h / 2 * k2)
    k4 = field(t + h, x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def transition(field: Field, t: Array, n: int, h: Array, substeps: int = 1) -> Float[Array, "n n"]:
    """The map x(t) -> x(t + h) of a linear time-varying field without input, by Runge-Kutta on each basis vector."""
    small = h / substeps

    def column(x: Array) -> Array:
        for i in range(substeps):
            x = rk4(field, t + i * small, x, small)
        return x

    return jax.vmap(column, 0, 1)(jnp.eye(n))


def after(doublings: Float[Array, "bits n n"], age: Int[Array, ""], x: Float[Array, "n"]) -> Float[Array, "n"]:
    """X carried over `age` ticks of a linear flow without input: e^{A age} x.

    `age` must lie in 0 .. 2^bits - 1; no check is made here.
    """

    def double(x: Array, row: Any) -> tuple[Array, None]:
        bit, E = row
        return jnp.where((age >> bit) & 1, E @ x, x), None

    return lax.scan(double, x, (jnp.arange(doublings.shape[0]), doublings))[0]


def covariance_after(
    doublings: Float[Array, "bits n n"],
    noise: Float[Array, "bits n n"],
    age: Int[Array, ""],
    P: Float[Array, "n n"],
) -> Float[Array, "n n"]:
    """P carried over `age` ticks: E P E' + Q, with the process noise of 2^b ticks in `noise[b]`."""

    def double(P: Array, row: Any) -> tuple[Array, None]:
        bit, E, Q = row
        return jnp.where((age >> bit) & 1, E @ P @ E.T + Q, P), None

    return lax.scan(double, P, (jnp.arange(doublings.shape[0]), doublings, noise))[0]
