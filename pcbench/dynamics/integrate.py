"""One tick and many ticks: the Runge-Kutta step of a field, and exact powers of a linear map.

A whole age is written with two digits to a base R. Its map is the product of one entry from each digit's table
(`dynamics.linear.powers`). The age may be traced, so one compiled program serves every delay, without any e^{-As}.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int, PyTree

from pcbench.dynamics.room import within_room

Field = Callable[[Array, PyTree], PyTree]  # (t [s], x) -> dx/dt; x an array, or a pytree of arrays


def rk4(field: Field, t: Array, x: PyTree, h: Array) -> PyTree:
    """Return x, an array or a pytree of arrays, after one classical Runge-Kutta step of h seconds from time t."""

    def advance(by: Array, k: PyTree) -> PyTree:
        return jax.tree.map(lambda x, k: x + by * k, x, k)

    def stage(carry: tuple[PyTree, PyTree], row: tuple[Array, Array]) -> tuple[PyTree, None]:
        (k, total), (part, weight) = carry, row
        k = field(t + part * h, advance(part * h, k))
        return (k, jax.tree.map(lambda total, k: total + weight * k, total, k)), None

    zero = jax.tree.map(jnp.zeros_like, x)
    # A loop, not four copies: the result of a stage is stored, while the compiler would compute it again for every use.
    (_, total), _ = lax.scan(stage, (zero, zero), (jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0])))
    return advance(h / 6, total)


def transition(field: Field, t: Array, n: int, h: Array, substeps: int = 1) -> Float[Array, "n n"]:
    """Return the map x(t) -> x(t + h) of a linear time-varying field without input, by Runge-Kutta on each basis vector."""
    small = h / substeps

    def column(x: Array) -> Array:
        for i in range(substeps):
            x = rk4(field, t + i * small, x, small)
        return x

    return jax.vmap(column, 0, 1)(jnp.eye(n))


def after(powers: Float[Array, "levels R n n"], age: Int[Array, ""], x: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """Return x propagated over `age` ticks of a linear flow without input: e^{A age} x.

    `age` must be in 0 .. R^levels - 1; only an exported observer checks it.
    """
    for E in _digit_entries(powers, age):
        x = E @ x
    return x


def covariance_after(
    powers: Float[Array, "levels R n n"],
    noise: Float[Array, "levels R n n"],
    age: Int[Array, ""],
    P: Float[Array, "n n"],
) -> Float[Array, "n n"]:
    """Return P propagated over `age` ticks: E P E' + Q, with the process noise of the ticks of each power in `noise`."""
    for E, Q in zip(_digit_entries(powers, age), _digit_entries(noise, age), strict=True):
        P = E @ P @ E.T + Q
    return P


def _digit_entries(powers: Array, age: Array) -> list[Array]:
    """Return the entry of each level's table for the digits of `age`, in one gather."""
    levels, R, *shape = powers.shape
    age = within_room(age, age < R**levels)
    digits = [level * R + age // R**level % R for level in range(levels)]
    return list(jnp.take(powers.reshape(levels * R, *shape), jnp.stack(digits), axis=0, mode="clip"))
