"""The two-state plant of networked control: x = [position, velocity], both measured.

    x' = [0 1; 0 -a] x + [0; b] u,   a = 0.1 1/s, b = 0.1,   y = x

Source: Zhang, Branicky, Phillips, IEEE Control Systems Magazine 21(1), 2001; units are ours. Ticks are exact under the held
input.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.plants import lti
from pcbench.plants.lti import Params

SIGNALS = (("position", "m"), ("velocity", "m/s"))


class Numbers(NamedTuple):
    """The plant; `plant.a`, `plant.b`, `plant.input_gain` and `plant.input_bias` are axes."""

    a: float = 0.1  # 1/s
    b: float = 0.1  # acceleration per unit of input
    input_gain: float = 1.0
    input_bias: float = 0.0  # unit of the input
    drift: float = 0.0  # has no effect


def nominal(numbers: Numbers) -> Model:
    """Return the model that observers use."""
    return Model(np.array([[0.0, 1.0], [0.0, -numbers.a]]), np.array([[0.0], [numbers.b]]), np.eye(2))


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of one tick of `dt` seconds."""
    return lti.prepare_model(nominal(numbers), numbers.input_gain, numbers.input_bias, dt, ticks)


PLANT = lti.PLANT
