"""The mobile cart below a camera of unknown delay: the plant of `cart`, with the delay of its samples as a signal.

`sensor_delay` is the delay of the scenario's samples, set by pcbench. Observers do not get it.
"""

from typing import NamedTuple

import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.linear import Model, discretize_zoh
from pcbench.plants import cart
from pcbench.plants.cart import SIGNALS
from pcbench.protocols import Leaf, Now, Plant

__all__ = ["PLANT", "SIGNALS", "UNKNOWNS", "Numbers", "nominal", "prepare"]
UNKNOWNS = (("delay", "s"),)


class Numbers(NamedTuple):
    """The cart's parameters; `plant.lam` and `plant.b` are axes."""

    lam: float = 122.0  # 1/s
    b: float = 355.0  # velocity gained per second and unit of input
    sensor_delay: float = 0.0  # s


class Params(NamedTuple):
    """x(t_k+1) = Phi x(t_k) + Gamma u_k."""

    Phi: Leaf  # [2, 2]
    Gamma: Leaf  # [2, 1]
    delay: Leaf  # s


def nominal(numbers: Numbers) -> Model:
    """Return the model that observers know."""
    return cart.nominal(cart.Numbers(numbers.lam, numbers.b))


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of a tick of `dt` seconds."""
    model = nominal(numbers)
    Phi, Gamma = discretize_zoh(model.A, model.B, dt)
    return Params(Phi, Gamma, np.asarray(numbers.sensor_delay))


def step(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "2"]:
    """Advance x by one tick under the held now.u."""
    return params.Phi @ x + params.Gamma @ now.u


def output(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "1"]:
    """Return the measured position [m]."""
    return x[:1]


def unknown(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "1"]:
    """Return the delay of samples [s]."""
    return params.delay[None]


PLANT = Plant(step, output, unknown=unknown)
