"""A particle in a double well, pushed by noise: x = [position], without a unit; two stable equilibria, -1 and 1.

    x' = 4 x (1 - x^2) + u

Noise, which is in the scenario, moves the particle from one well to the other now and then; the wall between them is at 0. A
filter that is linearised in a well has a small covariance, and follows such a transition late. u is 0 in the experiment.
Source: Miller, Ghil, Gauthiez 1994, of which the abstract was read. The drift is that of Miller, Carter, Blue 1999, as public
programs for this example have it. A tick is one Runge-Kutta step under the held input.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Matrix, Model
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (("position", "1"),)


class Numbers(NamedTuple):
    """The constants; each but `drift` is an axis."""

    rate: float = 4.0  # 1/s
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """The constants as arrays."""

    rate: Leaf


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the equations."""
    return Params(np.asarray(numbers.rate))


def nominal(n: Numbers) -> Model:
    """Return the model linearised at the unstable equilibrium 0."""
    return Model(np.array([[n.rate]]), np.ones((1, 1)), np.ones((1, 1)))


def residual(numbers: Numbers) -> Matrix:
    """Return dx/dt at the equilibrium 0, [1]."""
    return np.zeros(1)


def model(params: Params, now: Now, x: Float[Array, "1"], unknowns: Float[Array, "0"]) -> Float[Array, "1"]:
    """Return dx/dt under the held now.u; nothing is unknown."""
    return params.rate * x * (1.0 - x**2) + now.u


def field(params: Params, now: Now, x: Float[Array, "1"]) -> Float[Array, "1"]:
    """Return dx/dt under the held now.u."""
    return model(params, now, x, jnp.zeros(0))


def step(params: Params, now: Now, x: Float[Array, "1"]) -> Float[Array, "1"]:
    """Advance x by one tick under the held now.u."""
    return rk4(lambda t, x: field(params, now._replace(t=t), x), now.t, x, now.dt)


def output(params: Params, now: Now, x: Float[Array, "1"]) -> Float[Array, "1"]:
    """Return the measured position."""
    return x


PLANT = Plant(step, output, field)
