"""The growth model of the particle filter: a scalar in discrete time, whose square is measured.

    x(k+1) = x/2 + 25 x/(1 + x^2) + 8 cos(1.2 (k + phase)) + u(k),   y = x^2 / 20

The sign of x is seen in the motion only. phase = 0 is the model of Gordon, whose cosine has the index of the earlier state;
phase = 1 is the later form with the index of the new state. u is 0 in the experiment. Process noise, of variance 10 a step, is
in the scenario. A step is a tick of 1 s; the model has no unit of time.
Source: Gordon, Salmond, Smith 1993.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.linear import Model
from pcbench.plants.nonlinear import require_tick
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (("x", "1"),)
OUTPUTS = (("square", "1"),)
TICK = 1.0  # s


class Numbers(NamedTuple):
    """The model's constants; each but `drift` is an axis."""

    growth: float = 25.0
    forcing: float = 8.0
    phase: float = 0.0  # steps
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """The constants as arrays."""

    growth: Leaf
    forcing: Leaf
    phase: Leaf


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the constants; raise UserError if a tick is not one step."""
    require_tick(dt, TICK)
    return Params(np.asarray(numbers.growth), np.asarray(numbers.forcing), np.asarray(numbers.phase))


def nominal(numbers: Numbers) -> Model:
    """Return the model linearised at x = 0, where the output has no slope; nonlinear filters use `successor` and `sensor`."""
    return Model(np.array([[0.5 + numbers.growth]]), np.ones((1, 1)), np.zeros((1, 1)), discrete=True)


def successor(params: Params, now: Now, x: Float[Array, "1"], unknowns: Float[Array, "0"]) -> Float[Array, "1"]:
    """Return x one step later; nothing is unknown."""
    force = params.forcing * jnp.cos(1.2 * (now.tick + params.phase))
    return x / 2 + params.growth * x / (1 + x**2) + force + now.u


def sensor(params: Params, now: Now, x: Float[Array, "1"], unknowns: Float[Array, "0"]) -> Float[Array, "1"]:
    """Return the measured square; nothing is unknown."""
    return x**2 / 20


def step(params: Params, now: Now, x: Float[Array, "1"]) -> Float[Array, "1"]:
    """Advance x by one step under the held now.u."""
    return successor(params, now, x, jnp.zeros(0))


def output(params: Params, now: Now, x: Float[Array, "1"]) -> Float[Array, "1"]:
    """Return the measurement."""
    return sensor(params, now, x, jnp.zeros(0))


PLANT = Plant(step, output)
