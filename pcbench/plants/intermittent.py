"""The unstable scalar plant of Kalman filtering with intermittent observations, in discrete time.

    x(k+1) = a x(k) + u(k) + w,   y = x + v,   a = 1.25

A measurement arrives with probability p. The expected error covariance is bounded exactly for p > 1 - 1/a^2 = 0.36.
Source: Sinopoli et al. 2004. A step is a tick; the model has no unit of time. u is 0 in the experiment.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.plants import lti
from pcbench.plants.lti import Params

SIGNALS = (("x", "1"),)


class Numbers(NamedTuple):
    """The plant; each but `drift` is an axis."""

    a: float = 1.25  # a step
    input_gain: float = 1.0
    input_bias: float = 0.0  # unit of the input
    drift: float = 0.0  # has no effect


def nominal(numbers: Numbers) -> Model:
    """Return the model that observers use."""
    return Model(np.array([[numbers.a]]), np.ones((1, 1)), np.ones((1, 1)), discrete=True)


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of one step."""
    return lti.prepare_model(nominal(numbers), numbers.input_gain, numbers.input_bias, dt, ticks)


PLANT = lti.PLANT
