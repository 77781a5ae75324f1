"""The gas-phase batch reactor 2 A <-> B: x = [pressure_a, pressure_b], atm.

    pA' = -2 r + u,   pB' = r,   r = k1 pA^2 - k2 pB,   y = pA + pB

at constant volume and temperature, for an ideal gas. The total pressure is measured. u [atm/s] is an inflow of A, 0 in the
experiment and known to observers. The equations extend to negative pressures. With pA < 0 they have further equilibria with the
same total pressure. A tick is one Runge-Kutta step under the held input.
Source: Haseltine, Rawlings 2005; times, which have no unit there, are seconds.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Model
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (("pressure_a", "atm"), ("pressure_b", "atm"))
OUTPUTS = (("total_pressure", "atm"),)


class Numbers(NamedTuple):
    """The reactor's rates; `plant.k1` and `plant.k2` are axes."""

    k1: float = 0.16  # 1/(atm s)
    k2: float = 0.0064  # 1/s
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """Parameters of the equations."""

    k1: Leaf
    k2: Leaf


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the equations."""
    return Params(np.asarray(numbers.k1), np.asarray(numbers.k2))


def nominal(p: Numbers) -> Model:
    """Return the model linearised at zero pressures; observers of this plant use `model` instead."""
    A = np.array([[0.0, 2 * p.k2], [0.0, -p.k2]])
    return Model(A, np.array([[1.0], [0.0]]), np.ones((1, 2)))


def model(params: Params, now: Now, x: Float[Array, "2"], unknowns: Float[Array, "0"]) -> Float[Array, "2"]:
    """Return dx/dt under the held now.u; nothing is unknown."""
    r = params.k1 * x[0] ** 2 - params.k2 * x[1]
    return jnp.stack([now.u[0] - 2 * r, r])


def field(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "2"]:
    """Return dx/dt under the held now.u."""
    return model(params, now, x, jnp.zeros(0))


def step(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "2"]:
    """Advance x by one tick under the held now.u."""
    return rk4(lambda t, x: field(params, now._replace(t=t), x), now.t, x, now.dt)


def output(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "1"]:
    """Return the total pressure [atm]."""
    return jnp.sum(x)[None]


PLANT = Plant(step, output, field)
