"""The flexible joint of nonlinear observers: x = [motor_angle, motor_velocity, link_angle, link_velocity], rad and rad/s.

    x1' = x2     x2' = -48.6 (x1 - x3) - 1.25 x2 + 21.6 u
    x3' = x4     x4' = 19.5 (x1 - x3) - 3.33 sin(x3)

Measured is the motor angle. The nonlinearity has the Lipschitz constant 3.33 1/s^2. Units are decided here.
Source: Raghavan, Hedrick 1994, as public programs for this example have its constants; the paper itself was not obtained.
A tick is one Runge-Kutta step under the held input.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Matrix, Model
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (
    ("motor_angle", "rad"),
    ("motor_velocity", "rad/s"),
    ("link_angle", "rad"),
    ("link_velocity", "rad/s"),
)


class Numbers(NamedTuple):
    """The constants; each but `drift` is an axis."""

    motor_stiffness: float = 48.6  # 1/s^2
    motor_friction: float = 1.25  # 1/s
    input_gain: float = 21.6  # rad/s^2 per unit of input
    link_stiffness: float = 19.5  # 1/s^2
    gravity: float = 3.33  # 1/s^2
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """The constants as arrays."""

    motor_stiffness: Leaf
    motor_friction: Leaf
    input_gain: Leaf
    link_stiffness: Leaf
    gravity: Leaf


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the equations."""
    return Params(*(np.asarray(number) for number in numbers[:5]))


def nominal(n: Numbers) -> Model:
    """Return the model linearised with the link hanging at rest."""
    k, f, s = n.motor_stiffness, n.motor_friction, n.link_stiffness
    A = np.array([[0, 1, 0, 0], [-k, -f, k, 0], [0, 0, 0, 1], [s, 0, -s - n.gravity, 0]])
    return Model(A, np.array([[0.0], [n.input_gain], [0], [0]]), np.array([[1.0, 0, 0, 0]]))


def residual(numbers: Numbers) -> Matrix:
    """Return dx/dt at rest, [4]: 0 with any constants."""
    return np.zeros(4)


def model(params: Params, now: Now, x: Float[Array, "4"], unknowns: Float[Array, "0"]) -> Float[Array, "4"]:
    """Return dx/dt under the held now.u; nothing is unknown."""
    p, twist = params, x[0] - x[2]
    motor = -p.motor_stiffness * twist - p.motor_friction * x[1] + p.input_gain * now.u[0]
    return jnp.stack([x[1], motor, x[3], p.link_stiffness * twist - p.gravity * jnp.sin(x[2])])


def field(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Return dx/dt under the held now.u."""
    return model(params, now, x, jnp.zeros(0))


def step(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Advance x by one tick under the held now.u."""
    return rk4(lambda t, x: field(params, now._replace(t=t), x), now.t, x, now.dt)


def output(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "1"]:
    """Return the measured motor angle [rad]."""
    return x[:1]


PLANT = Plant(step, output, field)
