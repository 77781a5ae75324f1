"""The quadruple tank: x = levels of four tanks as deviations from the equilibrium [cm], two pumps [V], two level sensors [V].

    A1 h1' = -a1 q(h1) + a3 q(h3) + g1 k1 v1        A3 h3' = -a3 q(h3) + (1 - g2) k2 v2
    A2 h2' = -a2 q(h2) + a4 q(h4) + g2 k2 v2        A4 h4' = -a4 q(h4) + (1 - g1) k1 v1

    q(h) = sqrt(2 g h),   y = kc (h1, h2),   A1 = A3, A2 = A4, a1 = a3, a2 = a4

State, input and output are deviations from the exact equilibrium of the constants at one of two operating points [cm]:

    point                     v1 = v2   exact equilibrium              printed levels
    P-, minimum phase         3.00 V    12.263, 12.783, 1.634, 1.409   12.4, 12.7, 1.8, 1.4
    P+, non-minimum phase     3.15 V    12.442, 13.167, 4.730, 4.986   12.6, 13.0, 4.8, 4.9

The printed levels are no equilibrium of the printed constants. Below 0.01 cm q is proportional to h, so that an estimate below
0 has a slope.
Source: Johansson, IEEE Trans. Control Systems Technology 8(3), 2000. A tick is one Runge-Kutta step under the held input.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Matrix, Model
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (("level_1", "cm"), ("level_2", "cm"), ("level_3", "cm"), ("level_4", "cm"))
OUTPUTS = (("sensor_1", "V"), ("sensor_2", "V"))
EMPTY = 0.01  # cm


class Numbers(NamedTuple):
    """The constants, of the minimum-phase point; each but `point` and `drift` is an axis."""

    A1: float = 28.0  # cm^2, of tanks 1 and 3
    A2: float = 32.0  # cm^2, of tanks 2 and 4
    a1: float = 0.071  # cm^2, outlets of tanks 1 and 3
    a2: float = 0.057  # cm^2, outlets of tanks 2 and 4
    k1: float = 3.33  # cm^3/(V s)
    k2: float = 3.35  # cm^3/(V s)
    gamma1: float = 0.70  # share of pump 1 that goes to tank 1
    gamma2: float = 0.60  # share of pump 2 that goes to tank 2
    kc: float = 0.50  # V/cm
    g: float = 981.0  # cm/s^2
    point: str = "P-"  # the operating point, a name in `POINTS`
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """The constants as arrays, and the operating point."""

    outlet: Leaf  # [4] outlet over area
    upper: Leaf  # [2] outlets of tanks 3, 4 over the areas of tanks 1, 2
    pump: Leaf  # [4, 2] cm/(V s)
    kc: Leaf
    g: Leaf
    level: Leaf  # [4] cm, operating point
    voltage: Leaf  # [2] V, operating point


def pump_gains(n: Numbers) -> Matrix:
    """Return the rise of each level by each pump [4, 2], cm/(V s)."""
    direct = np.diag([n.gamma1 * n.k1 / n.A1, n.gamma2 * n.k2 / n.A2])
    cross = np.array([[0.0, (1 - n.gamma2) * n.k2 / n.A1], [(1 - n.gamma1) * n.k1 / n.A2, 0.0]])
    return np.vstack([direct, cross])


def equilibrium(n: Numbers, voltage: Matrix) -> Matrix:
    """Return the levels [4] in cm at which nothing moves under the voltages [2] in V."""
    v1, v2 = voltage
    flow3, flow4 = (1 - n.gamma2) * n.k2 * v2, (1 - n.gamma1) * n.k1 * v1
    flows = np.array([n.gamma1 * n.k1 * v1 + flow3, n.gamma2 * n.k2 * v2 + flow4, flow3, flow4])  # cm^3/s
    return (flows / np.array([n.a1, n.a2, n.a1, n.a2])) ** 2 / (2 * n.g)


class Point(NamedTuple):
    """An operating point: it does not depend on the constants of the true plant."""

    voltage: Matrix  # [2] V
    level: Matrix  # [4] cm


def _point(n: Numbers, volts: float) -> Point:
    voltage = np.full(2, volts)
    return Point(voltage, equilibrium(n, voltage))


POINTS = {
    "P-": _point(Numbers(), 3.0),
    "P+": _point(Numbers(k1=3.14, k2=3.29, gamma1=0.43, gamma2=0.34), 3.15),
}


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the equations."""
    n = numbers
    return Params(
        outlet=np.array([n.a1 / n.A1, n.a2 / n.A2, n.a1 / n.A1, n.a2 / n.A2]),
        upper=np.array([n.a1 / n.A1, n.a2 / n.A2]),
        pump=pump_gains(n),
        kc=np.asarray(n.kc),
        g=np.asarray(n.g),
        level=POINTS[n.point].level,
        voltage=POINTS[n.point].voltage,
    )


def time_constants(n: Numbers, level: Matrix) -> Matrix:
    """Return the time constants [4] in s of the tanks at levels [4] in cm."""
    return np.sqrt(2 * level / n.g) * np.array([n.A1 / n.a1, n.A2 / n.a2, n.A1 / n.a1, n.A2 / n.a2])


def linearize(n: Numbers, level: Matrix) -> Model:
    """Return the model linearised at levels [4] in cm."""
    T = time_constants(n, level)
    A = np.diag(-1 / T)
    A[0, 2], A[1, 3] = 1 / T[2], 1 / T[3]
    C = np.zeros((2, 4))
    C[0, 0] = C[1, 1] = n.kc
    return Model(A, pump_gains(n), C)


def nominal(numbers: Numbers) -> Model:
    """Return the model linearised at the operating point."""
    return linearize(numbers, POINTS[numbers.point].level)


def speed(g: Array, level: Array) -> Array:
    """Return the speed of the outflow [cm/s]."""
    root = jnp.sqrt(2 * g * jnp.maximum(level, EMPTY))
    return jnp.where(level > EMPTY, root, level * jnp.sqrt(2 * g / EMPTY))


def model(params: Params, now: Now, x: Float[Array, "4"], unknowns: Float[Array, "0"]) -> Float[Array, "4"]:
    """Return dx/dt under the held now.u; nothing is unknown."""
    q = speed(params.g, params.level + x)
    below = jnp.concatenate([params.upper * q[2:], jnp.zeros(2)])
    return below - params.outlet * q + params.pump @ (now.u + params.voltage)


def field(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Return dx/dt under the held now.u."""
    return model(params, now, x, jnp.zeros(0))


def residual(numbers: Numbers) -> Matrix:
    """Return dx/dt at the operating point, [4] in cm/s: 0 with the nominal constants."""
    p = prepare(numbers, 0.0, 0)
    q = np.sqrt(2 * p.g * p.level)
    rates = np.append(p.upper * q[2:], [0.0, 0.0]) - p.outlet * q + p.pump @ p.voltage
    return np.where(np.abs(rates) > 1e-12, rates, 0.0)


def step(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "4"]:
    """Advance x by one tick under the held now.u."""
    return rk4(lambda t, x: field(params, now._replace(t=t), x), now.t, x, now.dt)


def output(params: Params, now: Now, x: Float[Array, "4"]) -> Float[Array, "2"]:
    """Return the measured levels of tanks 1 and 2 [V], as deviations."""
    return params.kc * x[:2]


PLANT = Plant(step, output, field)
