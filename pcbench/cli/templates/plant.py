"""NAME: a plant of your own from its equations, in one file.

    pcbench check NAME.py:NAME        are the equations what observers take them for?
    pcbench run NAME.toml             observers on it: the study that stands beside this file

    x' = field(numbers, now, x)       how the state moves, n numbers, under the held input now.u [m]
    y  = output(numbers, now, x)      what is measured of it, q numbers

Both are pure functions written in jax.numpy for one run; pcbench carries them over thousands. Every number they use is in
`numbers`: a study may vary it (an axis `plant.length`), observers keep what stands here. Units are yours; SI is customary.

This one is a pendulum that hangs, turned by a motor at its pivot and watched by a camera from the front.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

import pcbench


class Numbers(NamedTuple):
    """Every number of the plant, with its unit."""

    length: float = 0.5  # m
    friction: float = 0.2  # 1/s
    gravity: float = 9.81  # m/s^2
    strength: float = 4.0  # rad/s^2 of the motor at full input


def field(numbers: Numbers, now: pcbench.Now, x: Array) -> Array:
    """Return dx/dt [n] of the whole state x: angle from straight down, rate."""
    angle, rate = x
    turned = -numbers.gravity / numbers.length * jnp.sin(angle) - numbers.friction * rate + numbers.strength * now.u[0]
    return jnp.stack([rate, turned])  # no `if`: jnp.where chooses, smoothly where observers take derivatives


def output(numbers: Numbers, now: pcbench.Now, x: Array) -> Array:
    """Return what is measured [q]: how far to the side the camera sees the bob [m]."""
    return jnp.stack([numbers.length * jnp.sin(x[0])])


NAME = pcbench.make_plant(
    field=field,  # or step=..., tick=0.01: where x one tick later is known, and no derivative
    output=output,
    states=["angle [rad]", "rate [rad/s]"],  # a name and a unit for each: they head the tables
    numbers=Numbers(),
    # Signals are deviations from this state and input. Linear observers (kf, pccebo, ...) get the Jacobians there, if it is
    # an equilibrium; ekf takes derivatives wherever its estimate is, so it does without.
    operating_point=([0.0, 0.0], [0.0]),
    # No observer is designed with these: ekf estimates them too. The unit, and between what values to look.
    unknown_parameters={"friction": ("1/s", 0.0, 2.0)},
    # unknown_inputs={"wind": "rad/s^2"}: what pushes without being measured; a number as well, and a term in field.
    positive=["length", "gravity"],  # a study that makes one of these 0 or less is refused
    summary="pendulum under a camera, 2 states",
)
