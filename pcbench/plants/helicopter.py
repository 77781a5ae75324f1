"""The helicopter with two degrees of freedom: x = [pitch, yaw, pitch_rate, yaw_rate] = [th, ps, th', ps'], rad and rad/s.

    M1 th'' = Ktt u1 + Ktp u2 - Bth th' - ml2 sin(th) cos(th) ps'^2 - mgl cos(th)        M1 = Jth + ml2
    M2 ps'' = Kpt u1 + Kpp u2 - Bps ps' + 2 ml2 sin(th) cos(th) th' ps'                  M2 = Jps + ml2 cos(th)^2

u = voltages of the pitch and yaw motors; ml2 = m l^2, mgl = m g l. Measured are pitch and yaw. Not known to observers are the
viscosities B = (Bth, Bps), signals `pitch_viscosity` and `yaw_viscosity` [N m s/rad]; a drift of size a multiplies both by
1 + a sin(2 pi t / 20 s).

Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, (37) to (41), Table 1. Different from print: its minus signs are
lost (restored by Euler-Lagrange); the friction of the pitch has the pitch rate, not the yaw rate (misprint in epsilon_1 and
alpha_1); viscosities are N m s/rad, not N/V. A tick is one Runge-Kutta step under the held input.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Model
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (("pitch", "rad"), ("yaw", "rad"), ("pitch_rate", "rad/s"), ("yaw_rate", "rad/s"))
UNKNOWNS = (("pitch_viscosity", "N m s/rad"), ("yaw_viscosity", "N m s/rad"))
RANGE = ((0.0, 2.0), (0.0, 2.0))  # range in which viscosities are estimated
DRIFT_PERIOD = 20.0  # s


class Numbers(NamedTuple):
    """The helicopter's parameters; `plant.m`, `plant.Bth` and the others are axes."""

    Jth: float = 0.0384  # kg m^2
    Jps: float = 0.0432  # kg m^2
    Bth: float = 0.8  # N m s/rad
    Bps: float = 0.318  # N m s/rad
    Ktt: float = 0.204  # N m/V
    Kpp: float = 0.072  # N m/V
    Ktp: float = 0.0068  # N m/V, pitch by the yaw motor
    Kpt: float = 0.0219  # N m/V, yaw by the pitch motor
    m: float = 1.3872  # kg
    l: float = 0.186  # m
    g: float = 9.81  # m/s^2
    drift: float = 0.0  # a


class Params(NamedTuple):
    """Parameters of the equations."""

    J: Leaf  # [2] kg m^2
    K: Leaf  # [2, 2] N m/V
    B: Leaf  # [2] N m s/rad, the viscosities without drift
    ml2: Leaf  # kg m^2
    mgl: Leaf  # N m
    drift: Leaf


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the equations."""
    n = numbers
    K, J, B = [[n.Ktt, n.Ktp], [n.Kpt, n.Kpp]], [n.Jth, n.Jps], [n.Bth, n.Bps]
    return Params(*map(np.asarray, (J, K, B, n.m * n.l**2, n.m * n.g * n.l, n.drift)))


def nominal(p: Numbers) -> Model:
    """Return the model linearised at rest and level, th = 0; observers of this plant use `parts` instead."""
    q = prepare(p, 0.0, 0)
    M = q.J + q.ml2
    A, B = np.zeros((4, 4)), np.zeros((4, 2))
    A[:2, 2:], A[2:, 2:], B[2:] = np.eye(2), -np.diag(q.B / M), q.K / M[:, None]
    return Model(A, B, np.eye(2, 4))


def inertia(params: Params, pitch: Array) -> Float[Array, "2"]:
    """Return M1, M2 at a pitch."""
    return params.J + params.ml2 * jnp.stack([jnp.ones_like(pitch), jnp.cos(pitch) ** 2])


def torque(params: Params, pitch: Array, rates: Float[Array, "2"]) -> Float[Array, "2"]:
    """Return the torques of gravity and of the products of rates."""
    cross = params.ml2 * jnp.sin(pitch) * jnp.cos(pitch)
    fall = -cross * rates[1] ** 2 - params.mgl * jnp.cos(pitch)
    return jnp.stack([fall, 2 * cross * rates[0] * rates[1]])


def parts(params: Params, u: Float[Array, "2"], x: Float[Array, "4"]) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Return (a, phi) of the accelerations a B + phi: a = -rates / M, phi without friction. Source: (50)."""
    M = inertia(params, x[0])
    return -x[2:] / M, (params.K @ u + torque(params, x[0], x[2:])) / M


def model(params: Params, now: Now, x: Float[Array, "4"], B: Float[Array, "2"]) -> Float[Array, "4"]:
    """Return dx/dt with viscosities B under the held now.u."""
    a, phi = parts(params, now.u, x)
    return jnp.concatenate([x[2:], a * B + phi])


def inverse(params: Params, B: Array, target: Array, rates: Array, accelerations: Array) -> Float[Array, "2"]:
    """Return the voltages for motion along a path: positions, rates and accelerations, [2] each."""
    need = inertia(params, target[0]) * accelerations + B * rates - torque(params, target[0], rates)
    (a, b), (c, d) = params.K[0], params.K[1]
    return jnp.stack([d * need[0] - b * need[1], a * need[1] - c * need[0]]) / (a * d - b * c)


def unknown(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "2"]:
    """Return the viscosities at now.t."""
    return params.B * (1 + params.drift * jnp.sin(2 * np.pi / DRIFT_PERIOD * now.t))


def field(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Return dx/dt at the stage's time now.t under the held now.u."""
    return model(params, now, x, unknown(params, now, x))


def step(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Advance x by one tick under the held now.u."""
    return rk4(lambda t, x: field(params, now._replace(t=t), x), now.t, x, now.dt)


def output(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "2"]:
    """Return the measured pitch and yaw [rad]."""
    return x[:2]


PLANT = Plant(step, output, field, unknown)
