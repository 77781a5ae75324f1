"""A platform that follows a moving target: a camera on it sees the target, an encoder measures its position.

    offset' = v - u,   r' = v,   v' = -(2 pi f)^2 r - 2 zeta (2 pi f) v,   y = (offset, r - offset)

x = [offset, r, v]: position of the target relative to the platform, position and velocity of the target. The platform is at
r - offset, and u is its velocity. The target sways about 0 and random accelerations drive it, so its motion is stationary. The
camera measures the offset and the encoder the platform. Ticks are exact under the held input.
Source: the task of Xiao, Chen, Int. J. Intelligent Robotics and Applications, 2020, of which only the abstract was read. The
model and all numbers are this project's.
"""

from math import pi
from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.plants import lti
from pcbench.plants.lti import Params

SIGNALS = (("offset", "m"), ("target", "m"), ("target_velocity", "m/s"))
OUTPUTS = (("offset", "m"), ("platform", "m"))


class Numbers(NamedTuple):
    """Target and platform; each but `drift` is an axis."""

    frequency: float = 0.25  # Hz, of the target
    damping: float = 0.1  # zeta
    input_gain: float = 1.0
    input_bias: float = 0.0  # m/s
    drift: float = 0.0  # has no effect


def nominal(numbers: Numbers) -> Model:
    """Return the model that observers use."""
    rate = 2 * pi * numbers.frequency
    A = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, -(rate**2), -2 * numbers.damping * rate]])
    return Model(A, np.array([[-1.0], [0.0], [0.0]]), np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0]]))


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of one tick of `dt` seconds."""
    return lti.prepare_model(nominal(numbers), numbers.input_gain, numbers.input_bias, dt, ticks)


PLANT = lti.PLANT
