"""A body that falls through the air, seen by a radar: x = altitude [ft], speed downwards [ft/s], drag coefficient [1/ft].

    x1' = -x2,   x2' = -exp(-gamma x1) x2^2 x3 + u,   x3' = 0,   y = sqrt(M^2 + (x1 - H)^2)

M is the horizontal distance of the radar, H its altitude. The coefficient is seen in the deceleration only. u [ft/s^2] is 0 in
the experiment, which has no gravity. Units are those of the source.
Source: Athans, Wishner, Bertolini 1968; Julier, Uhlmann, Durrant-Whyte 2000. Neither paper was obtained: M, H and the noise are
those of a public program that names them, and its 1 / 20000 ft is gamma = 5e-5 1/ft. A tick is one
Runge-Kutta step.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Model
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (("altitude", "ft"), ("speed", "ft/s"), ("drag", "1/ft"))
OUTPUTS = (("distance", "ft"),)
START = (3e5, 2e4, 1e-3)  # state at which the linear model is taken


class Numbers(NamedTuple):
    """The constants; each but `drift` is an axis."""

    gamma: float = 5e-5  # 1/ft
    distance: float = 1e5  # ft, M
    height: float = 1e5  # ft, H
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """The constants as arrays."""

    gamma: Leaf
    distance: Leaf
    height: Leaf


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the equations."""
    return Params(*(np.asarray(number) for number in numbers[:3]))


def nominal(numbers: Numbers) -> Model:
    """Return the model linearised at the start; nonlinear filters use `model` and `sensor`."""
    x1, x2, x3 = START
    density = np.exp(-numbers.gamma * x1)
    A = np.array(
        [[0, -1, 0], [numbers.gamma * density * x2**2 * x3, -2 * density * x2 * x3, -density * x2**2], [0, 0, 0]]
    )
    relative_height = x1 - numbers.height
    C = np.array([[relative_height / np.hypot(numbers.distance, relative_height), 0.0, 0.0]])
    return Model(A, np.array([[0.0], [1.0], [0.0]]), C)


def model(params: Params, now: Now, x: Float[Array, "3"], unknowns: Float[Array, "0"]) -> Float[Array, "3"]:
    """Return dx/dt under the held now.u; nothing is unknown."""
    drag = jnp.exp(-params.gamma * x[0]) * x[1] ** 2 * x[2]
    return jnp.stack([-x[1], now.u[0] - drag, jnp.zeros(())])


def sensor(params: Params, now: Now, x: Float[Array, "3"], unknowns: Float[Array, "0"]) -> Float[Array, "1"]:
    """Return the distance from the radar [ft]; nothing is unknown."""
    return jnp.sqrt(params.distance**2 + (x[:1] - params.height) ** 2)


def field(params: Params, now: Now, x: Float[Array, "3"]) -> Float[Array, "3"]:
    """Return dx/dt under the held now.u."""
    return model(params, now, x, jnp.zeros(0))


def step(params: Params, now: Now, x: Float[Array, "3"]) -> Float[Array, "3"]:
    """Advance x by one tick under the held now.u."""
    return rk4(lambda t, x: field(params, now._replace(t=t), x), now.t, x, now.dt)


def output(params: Params, now: Now, x: Float[Array, "3"]) -> Float[Array, "1"]:
    """Return the measured distance [ft]."""
    return sensor(params, now, x, jnp.zeros(0))


PLANT = Plant(step, output, field)
