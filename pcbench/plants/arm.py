"""The flexible-joint arm: x = [link_angle, link_velocity, motor_angle, motor_velocity], rad and rad/s.

    x1' = x2     Jl x2' = -Fl x2 + k (x3 - x1) - M g l sin(x1) + Jl d(t)
    x3' = x4     Jm x4' = -Fm x4 - k (x3 - x1) + u                                           (53)

Measured are link velocity and motor angle. For an observer x' = A x + B u + E f with the unknown f = -delta sin(x1) + d(t),
with delta = M g l / Jl = 0.11025 1/s^2, observers know -delta sin(x1) as a function of the estimate. The signal `input` is d. A
drift of size a multiplies k/J, M g l/J and F/J of a run by 1 + a sin(w t + phi), all three alike; each run draws its w, uniform
in 0.2 .. 2 rad/s, and its phi. The paper has no drift.

Source: Peng, Appl. Sci. 2017, 7(1), 67, section 5. Different from print: its minus signs are lost; E is its D. A tick is one
Runge-Kutta step of the field under the held input, with d at the stages i dt, (i + 1/2) dt, (i + 1) dt.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Model
from pcbench.protocols import Leaf, Now, Plant
from pcbench.scenarios.signals import inputs

SIGNALS = (
    ("link_angle", "rad"),
    ("link_velocity", "rad/s"),
    ("motor_angle", "rad"),
    ("motor_velocity", "rad/s"),
)
UNKNOWNS = (("input", "rad/s^2"),)
SLOWEST, FASTEST = 0.2, 2.0  # frequency range of the drift [rad/s]


class Numbers(NamedTuple):
    """The arm's parameters; `plant.k`, `plant.J` and the others are axes."""

    J: float = 4.0  # kg m^2, of the link and of the motor
    k: float = 15.0  # N m/rad
    M: float = 0.15  # kg
    l: float = 0.3  # m
    Fl: float = 0.006  # N m s/rad
    Fm: float = 0.005  # N m s/rad
    g: float = 9.8  # m/s^2
    drift: float = 0.0  # a
    unknown_input: str = "zero"  # d


class Params(NamedTuple):
    """Parameters divided by J: stiffness k, gravity M g l, frictions; and d at the stages."""

    stiffness: Leaf  # 1/s^2
    gravity: Leaf  # 1/s^2
    friction: Leaf  # [2] 1/s, of link and motor
    torque: Leaf  # 1/(kg m^2)
    d: Leaf  # [2 N + 3] rad/s^2 at (j/2) dt
    drift: Leaf
    pace: Leaf  # rad/s, frequency w of the drift
    phase: Leaf  # rad, phase phi of the drift


def nominal(p: Numbers) -> Model:
    """Return the model for designs, with E and the known part of f."""
    k, a, b = p.k / p.J, p.Fl / p.J, p.Fm / p.J
    A = np.array([[0, 1, 0, 0], [-k, -a, k, 0], [0, 0, 0, 1], [k, 0, -k, -b]])
    B, C = np.array([[0.0], [0], [0], [1 / p.J]]), np.array([[0.0, 1, 0, 0], [0, 0, 1, 0]])
    known_part = jax.tree_util.Partial(pull, np.asarray(p.M * p.g * p.l / p.J))
    return Model(A, B, C, E=np.array([[0.0], [1], [0], [0]]), nonlinearity=known_part)


def pull(delta: Array, x: Float[Array, "4"]) -> Float[Array, "1"]:
    """Return the known part of f: the torque of gravity on the link, -delta sin(x1)."""
    return -delta * jnp.sin(x[:1])


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the field, with d at every stage of ticks 0 .. `ticks`."""
    n = numbers
    d = inputs(n.unknown_input, np.arange(2 * ticks + 3) / 2 * dt, 1)[:, 0]
    return Params(
        stiffness=np.asarray(n.k / n.J),
        gravity=np.asarray(n.M * n.g * n.l / n.J),
        friction=np.array([n.Fl, n.Fm]) / n.J,
        torque=np.asarray(1 / n.J),
        d=d,
        drift=np.asarray(n.drift),
        pace=np.asarray(0.0),
        phase=np.asarray(0.0),
    )


def of_run(params: Params, uniform: Float[Array, "2"]) -> Params:
    """Return the parameters of one run, with its drift's frequency and phase."""
    return params._replace(
        pace=SLOWEST + (FASTEST - SLOWEST) * uniform[0],
        phase=2 * np.pi * uniform[1],
    )


def disturbance(params: Params, now: Now) -> Array:
    """Return d at the stage's time now.t."""
    return params.d[jnp.round(2 * now.t / now.dt).astype(int)]


def field(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Return dx/dt at the stage's time now.t under the held now.u."""
    factor = 1 + params.drift * jnp.sin(params.pace * now.t + params.phase)
    spring = factor * params.stiffness * (x[2] - x[0])
    link = spring - factor * (params.friction[0] * x[1] + params.gravity * jnp.sin(x[0])) + disturbance(params, now)
    motor = params.torque * now.u[0] - spring - factor * params.friction[1] * x[3]
    return jnp.stack([x[1], link, x[3], motor])


def step(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Advance x by one tick under the held now.u."""
    return rk4(lambda t, x: field(params, now._replace(t=t), x), now.t, x, now.dt)


def output(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "2"]:
    """Return the measured link velocity [rad/s] and motor angle [rad]."""
    return x[1:3]


def unknown(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "1"]:
    """Return d at now.t."""
    return disturbance(params, now)[None]


PLANT = Plant(step, output, field, unknown, 2, of_run)
