"""NAME: your own plant from its equations, in one file.

    pcbench check NAME.py:NAME        check the equations and their derivatives
    pcbench run NAME.toml             run the study in NAME.toml, next to this file

    x' = field(numbers, now, x)       time derivative of the state [n] under the held input now.u [m]
    y  = output(numbers, now, x)      measured output [q]

Both are pure functions. Write them in jax.numpy for one run; pcbench applies them to thousands. All numbers that they use are
in `numbers`. A study can vary a true value (axis `plant.length`); observers assume the values below. Use any units, such as SI.

This plant is a hanging pendulum with a motor at its pivot and a camera in front of it.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

import pcbench


class Numbers(NamedTuple):
    """All numbers of the plant, with their units."""

    length: float = 0.5  # m
    friction: float = 0.2  # 1/s
    gravity: float = 9.81  # m/s^2
    strength: float = 4.0  # rad/s^2, acceleration by the motor at full input


def field(numbers: Numbers, now: pcbench.Now, x: Array) -> Array:
    """Return dx/dt [n] of the whole state x: angle from straight down, rate."""
    angle, rate = x
    acceleration = (
        -numbers.gravity / numbers.length * jnp.sin(angle) - numbers.friction * rate + numbers.strength * now.u[0]
    )
    return jnp.stack([rate, acceleration])  # use jnp.where instead of `if`; observers need derivatives


def output(numbers: Numbers, now: pcbench.Now, x: Array) -> Array:
    """Return the measured output [q]: the lateral position of the bob [m]."""
    return jnp.stack([numbers.length * jnp.sin(x[0])])


NAME = pcbench.make_plant(
    field=field,  # or step=..., tick=0.01, if you have x one tick later instead of a derivative
    output=output,
    states=["angle [rad]", "rate [rad/s]"],  # name and unit of each state, for the tables
    numbers=Numbers(),
    # Signals are deviations from this state and input. Linear observers (kf, pccebo, ...) use the Jacobians at this point if
    # it is an equilibrium. ekf uses the derivatives at its estimate, so it works at any point.
    operating_point=([0.0, 0.0], [0.0]),
    # Parameters that ekf estimates: unit, lower and upper limit. The design does not use their true values.
    unknown_parameters={"friction": ("1/s", 0.0, 2.0)},
    # unknown_inputs={"wind": "rad/s^2"}: inputs that are not measured; add a number and a term in field.
    positive=["length", "gravity"],  # pcbench refuses a study in which one of these is not positive
    summary="pendulum in front of a camera, 2 states",
)
