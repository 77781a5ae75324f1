"""The unstable batch reactor of networked control: four states, two inputs, two outputs on two nodes of a network.

    x' = A x + B u,   y = (x1 + x3 - x4, x2)

A has the eigenvalues 1.9910, 0.0635, -5.0566 and -8.6659 1/s. The plant is linearised and its states have no units in print.
Source: Walsh, Ye, IEEE Control Systems Magazine 21(1), 2001, as public programs that name it have its numbers; the paper itself
was not obtained. Ticks are exact under the held input.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.plants import lti
from pcbench.plants.lti import Params

SIGNALS = (("x1", "1"), ("x2", "1"), ("x3", "1"), ("x4", "1"))
OUTPUTS = (("first_node", "1"), ("second_node", "1"))
A = (
    (1.38, -0.2077, 6.715, -5.676),
    (-0.5814, -4.29, 0.0, 0.675),
    (1.067, 4.273, -6.654, 5.893),
    (0.048, 4.273, 1.343, -2.104),
)  # 1/s
B = ((0.0, 0.0), (5.679, 0.0), (1.136, -3.146), (1.136, 0.0))
C = ((1.0, 0.0, 1.0, -1.0), (0.0, 1.0, 0.0, 0.0))


class Numbers(NamedTuple):
    """Parameters by which the plant may differ from its model; `plant.input_gain` and `plant.input_bias` are axes."""

    input_gain: float = 1.0
    input_bias: float = 0.0  # of both inputs
    drift: float = 0.0  # has no effect


def nominal(numbers: Numbers) -> Model:
    """Return the model that observers use."""
    return Model(np.array(A), np.array(B), np.array(C))


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of one tick of `dt` seconds."""
    return lti.prepare_model(nominal(numbers), numbers.input_gain, numbers.input_bias, dt, ticks)


PLANT = lti.PLANT
