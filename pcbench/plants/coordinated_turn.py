"""An aircraft that turns at an unknown rate, seen by a radar: x = position x, velocity x, position y, velocity y, turn rate.

    x+  = x + s vx - c vy       vx+ = cos(w T) vx - sin(w T) vy        s = sin(w T) / w
    y+  = y + c vx + s vy       vy+ = sin(w T) vx + cos(w T) vy        c = (1 - cos(w T)) / w        w+ = w

    range = sqrt(x^2 + y^2) [m],   bearing = atan2(y, x) [rad]

A tick is the source's step T = 1 s, in which w [rad/s] is constant. The radar is at the origin. There is no input: u has no
effect. The bearing jumps by 2 pi behind the radar, so filters use a difference that wraps.
Source: Arasaratnam, Haykin, IEEE Trans. Automatic Control 54(6), 2009.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.linear import Model
from pcbench.plants.nonlinear import require_tick
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (
    ("position_x", "m"),
    ("velocity_x", "m/s"),
    ("position_y", "m"),
    ("velocity_y", "m/s"),
    ("turn_rate", "rad/s"),
)
ERRORS = (("position", "m"), ("velocity", "m/s"))
OUTPUTS = (("range", "m"), ("bearing", "rad"))
START = (1000.0, 300.0, 1000.0, 0.0, float(np.radians(-3.0)))  # where the linear model is taken
TICK = 1.0  # s
STRAIGHT = 1e-4  # rad/s: below it s and c are series, exact to rounding for T = 1 s


class Numbers(NamedTuple):
    """The place of the radar; each but `drift` is an axis."""

    radar_x: float = 0.0  # m
    radar_y: float = 0.0  # m
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """The place of the radar as arrays."""

    radar_x: Leaf
    radar_y: Leaf


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the place of the radar; raise UserError if a tick is not one step."""
    require_tick(dt, TICK)
    return Params(np.asarray(numbers.radar_x), np.asarray(numbers.radar_y))


def nominal(numbers: Numbers) -> Model:
    """Return the model linearised at the start; nonlinear filters use `successor` and `sensor`."""
    x, vx, y, vy, w = START
    sin, cos = np.sin(w), np.cos(w)
    s, c = sin / w, (1 - cos) / w
    ds, dc = (cos - s) / w, (sin - c) / w  # slopes in w
    A = np.array(
        [
            [1, s, 0, -c, ds * vx - dc * vy],
            [0, cos, 0, -sin, -sin * vx - cos * vy],
            [0, c, 1, s, dc * vx + ds * vy],
            [0, sin, 0, cos, cos * vx - sin * vy],
            [0, 0, 0, 0, 1],
        ]
    )
    dx, dy = x - numbers.radar_x, y - numbers.radar_y
    r = np.hypot(dx, dy)
    C = np.array([[dx / r, 0, dy / r, 0, 0], [-dy / r**2, 0, dx / r**2, 0, 0]])
    return Model(A, np.zeros((5, 1)), C, discrete=True)


def successor(params: Params, now: Now, x: Float[Array, "5"], unknowns: Float[Array, "0"]) -> Float[Array, "5"]:
    """Return x one step later; nothing is unknown."""
    px, vx, py, vy, w = x
    is_straight = jnp.abs(w) < STRAIGHT
    divisor = jnp.where(is_straight, 1.0, w)
    s = jnp.where(is_straight, 1 - w**2 / 6, jnp.sin(w) / divisor)
    c = jnp.where(is_straight, w / 2 - w**3 / 24, 2 * jnp.sin(w / 2) ** 2 / divisor)
    sin, cos = jnp.sin(w), jnp.cos(w)
    return jnp.stack([px + s * vx - c * vy, cos * vx - sin * vy, py + c * vx + s * vy, sin * vx + cos * vy, w])


def sensor(params: Params, now: Now, x: Float[Array, "5"], unknowns: Float[Array, "0"]) -> Float[Array, "2"]:
    """Return range [m] and bearing [rad] from the radar; nothing is unknown."""
    dx, dy = x[0] - params.radar_x, x[2] - params.radar_y
    return jnp.stack([jnp.sqrt(dx**2 + dy**2), jnp.arctan2(dy, dx)])


def output_residual(params: Params, y: Float[Array, "2"], yhat: Float[Array, "2"]) -> Float[Array, "2"]:
    """Return y - yhat [m, rad], its bearing between -pi and pi."""
    angle = y[1] - yhat[1]
    return jnp.stack([y[0] - yhat[0], jnp.arctan2(jnp.sin(angle), jnp.cos(angle))])


def step(params: Params, now: Now, x: Float[Array, "5"]) -> Float[Array, "5"]:
    """Advance x by one step."""
    return successor(params, now, x, jnp.zeros(0))


def output(params: Params, now: Now, x: Float[Array, "5"]) -> Float[Array, "2"]:
    """Return the measured range [m] and bearing [rad]."""
    return sensor(params, now, x, jnp.zeros(0))


def errors(params: Params, now: Now, x: Float[Array, "5"], xhat: Float[Array, "5"]) -> Float[Array, "2"]:
    """Return the distance of the estimated from the true position [m], and that of the velocities [m/s]."""
    error = x - xhat
    return jnp.sqrt(jnp.stack([error[0] ** 2 + error[2] ** 2, error[1] ** 2 + error[3] ** 2]))


PLANT = Plant(step, output, errors=errors, scored=len(ERRORS))
