"""The stirred tank heater: volume, enthalpy and jacket temperature, as deviations; three sensors of different delay.

    V' = u1,   H' = k (T_jacket - T_tank) - rho c q T_tank,   mc T_jacket' = u2 - k (T_jacket - T_tank),   T_tank = H/(rho c V)

linearised, with r = c22 a21 / |a22| (what a litre more, at the same enthalpy, takes off the tank's temperature). Measured are
the level [mm], the tank's and the jacket's temperature [degC]; inputs are the net inflow [L/s] and the heater's power [W].
`literal` is the recursion that the paper computed: its continuous-time numbers per sample, without the terms in r and k.
Source: Alipouri, Zhong, Actuators 2021, 10, 281, section 5. Different from print: signs restored from the printed design;
A31, A32 and A23 = k follow from the balances and are not printed; "3041.5241" is 30411.5241. Ticks are exact under the held
input.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.plants import lti
from pcbench.plants.lti import Params

SIGNALS = (("volume", "L"), ("enthalpy", "J"), ("jacket_temperature", "degC"))
OUTPUTS = (("level", "mm"), ("tank_temperature", "degC"), ("jacket_temperature", "degC"))


class Numbers(NamedTuple):
    """The parameters, also as assumed by observers."""

    a21: float = 626.4371  # J/(L s)
    a22: float = -5.9406e-3  # 1/s
    c11: float = 31.831  # mm/L
    c22: float = 3.8578e-5  # degC/J
    k: float = 36.55  # W/degC
    mc: float = 30411.5241  # J/degC
    literal: bool = False
    input_gain: float = 1.0
    input_bias: float = 0.0  # of both inputs
    drift: float = 0.0  # has no effect


def nominal(p: Numbers) -> Model:
    """Return the model for designs: continuous, or the printed recursion."""
    if p.literal:
        A = np.array([[0, 0, 0], [p.a21, p.a22, 0], [0, 0, -1.2019e-3]])
        return Model(A, np.array([[1, 0], [0, 0], [0, p.mc]]), np.diag([p.c11, p.c22, 1]), None, True)
    r = p.c22 * p.a21 / abs(p.a22)
    A = np.array([[0, 0, 0], [p.a21, p.a22, p.k], [-p.k * r / p.mc, p.k * p.c22 / p.mc, -p.k / p.mc]])
    return Model(A, np.array([[1, 0], [0, 0], [0, 1 / p.mc]]), np.array([[p.c11, 0, 0], [-r, p.c22, 0], [0, 0, 1]]))


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of one tick of `dt` seconds."""
    return lti.prepare_model(nominal(numbers), numbers.input_gain, numbers.input_bias, dt, ticks)


PLANT = lti.PLANT
