"""An anaerobic digester: x = twelve concentrations as deviations from an equilibrium [g/L], feed u [L/d], six outputs.

    xl' = S r(x) + (u / Vl) (inlet - xl) - (transfer of methane and carbon dioxide)          the ten of the liquid
    xg' = (transfer) Vl / Vg - q xg / Vg                                                   methane and carbon dioxide
    r = (kF x5, kS x6, kp x7, kl x8, kd x9) [g/(L d)],   transfer = kla (x1 - H1 x11, x2 - H2 x12)
    p = (R T x11 / 16, R T x12 / 44) [bar],   q = (flow / p0) (p1 + p2 - p0) (p1 + p2) [L/d]

    y = q [L/d], p1, p2 [bar], inorganic nitrogen [g/L], total solids 1 - x4/rho, volatile solids 1 - x10/(rho - x4)

State, input and outputs are deviations from the equilibrium of the constants under a constant feed, at one of two operating
points:

    point     feed          note
    slow      5.571 L/d     the mean of the feed of `multirate`
    printed   133.714 L/d   the mean feed of the public program, which replaces the 100 L of the tank in 0.75 d

The gas moves within seconds, so a tick of 0.5 h is four steps of a linearly implicit method of order 2 (ROS2, Verwer et al.
1999) with the slopes of x1, x2, x11 and x12. It is L-stable for them, and of order 2 for any omitted slopes.
Source: Hellmann, Wilms, Streif, Weinrich, arXiv 2512.20354. Its text was not obtained: equations and constants are those of an
earlier public program by its first author (ADM1-R4 with two kinds of carbohydrates).
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from pcbench.dynamics.linear import Matrix, Model
from pcbench.protocols import Leaf, Now, Plant, vmap_as_unit

SIGNALS = (
    ("methane", "g/L"),
    ("inorganic_carbon", "g/L"),
    ("inorganic_nitrogen", "g/L"),
    ("water", "g/L"),
    ("fast_carbohydrates", "g/L"),
    ("slow_carbohydrates", "g/L"),
    ("proteins", "g/L"),
    ("lipids", "g/L"),
    ("biomass", "g/L"),
    ("ash", "g/L"),
    ("methane_gas", "g/L"),
    ("carbon_dioxide_gas", "g/L"),
)
OUTPUTS = (
    ("gas_flow", "L/d"),
    ("methane_pressure", "bar"),
    ("carbon_dioxide_pressure", "bar"),
    ("inorganic_nitrogen", "g/L"),
    ("total_solids", "1"),
    ("volatile_solids", "1"),
)
DAY = 86400.0  # s
STEPS = 4  # of a tick
GAMMA = 1 + 1 / np.sqrt(2)  # of ROS2; the other root oscillates if pressures start a few per cent off
STOICHIOMETRY = (
    np.array(  # of methane, carbon, nitrogen, water and biomass [5], for a gram of each of four substrates [4]
        [
            [0.2482, 0.2482, 0.3221, 0.6393],
            [0.6809, 0.6809, 0.7954, 0.5817],
            [-0.0207, -0.0207, 0.1689, -0.0344],
            [-0.0456, -0.0456, -0.4588, -0.4152],
            [0.1372, 0.1372, 0.1723, 0.2286],
        ]
    )
)
REACTION_STATES = [0, 1, 2, 3, 8]  # states with rows in it
DECAY = {4: 0.18, 6: 0.77, 7: 0.05, 8: -1.0}  # products per gram of dead biomass
RHO, RT_CH4, RT_CO2 = 1000.0, 0.08315 * 273.15 / 16, 0.08315 * 273.15 / 44  # g/L, bar L/g at 0 degrees Celsius
FAST = (0, 1, 10, 11)  # the states whose slopes a step uses


class Numbers(NamedTuple):
    """The constants; each but `point` and `drift` is an axis."""

    kF: float = 0.25  # 1/d, hydrolysis of fast carbohydrates
    kS: float = 0.025  # 1/d, of slow carbohydrates
    kp: float = 0.2  # 1/d, of proteins
    kl: float = 0.1  # 1/d, of lipids
    kd: float = 0.02  # 1/d, decay of biomass
    fast: float = 0.5  # share of the carbohydrates in the feed that are fast
    kla: float = 200.0  # 1/d, transfer to the gas
    Kch4: float = 0.0011  # mol/(L bar)
    Kco2: float = 0.025  # mol/(L bar)
    flow: float = 5e4  # L/(d bar), friction of the outflow of gas
    p0: float = 1.013  # bar
    Vl: float = 100.0  # L
    Vg: float = 10.0  # L
    point: str = "slow"  # the operating point, a name in `FEEDS`
    drift: float = 0.0  # has no effect


class Params(NamedTuple):
    """The constants as arrays, and the operating point."""

    linear: Leaf  # [12, 12] 1/d, all but dilution and outflow of gas
    inlet: Leaf  # [12] g/L
    kla: Leaf  # 1/d
    henry: Leaf  # [2] gas to liquid at rest
    flow: Leaf  # L/(d bar^2)
    p0: Leaf  # bar
    Vl: Leaf
    Vg: Leaf
    level: Leaf  # [12] g/L, operating point
    feed: Leaf  # L/d, operating point


FEEDS = {"slow": 39.0 / 7, "printed": 936.0 / 7}  # L/d
LIQUID = np.array([1.0] * 10 + [0.0] * 2)


def linear_part(n: Numbers) -> Matrix:
    """Return reactions and transfer [12, 12], 1/d."""
    out = np.zeros((12, 12))
    rates = np.array([n.kF, n.kS, n.kp, n.kl])
    for j, rate in enumerate(rates):
        out[REACTION_STATES, 4 + j] += STOICHIOMETRY[:, j] * rate
        out[4 + j, 4 + j] -= rate
    for i, share in DECAY.items():
        out[i, 8] += share * n.kd
    for liquid, gas, henry in ((0, 10, n.Kch4 * RT_CH4 * 16), (1, 11, n.Kco2 * RT_CO2 * 44)):
        transfer = n.kla * np.array([1.0, -henry])
        out[liquid, [liquid, gas]] -= transfer
        out[gas, [liquid, gas]] += transfer * n.Vl / n.Vg
    return out


def inlet(n: Numbers) -> Matrix:
    """Return the concentrations of the feed [12] in g/L; it has no gas."""
    return np.array([0, 0, 0.592, 960.512, n.fast * 23.398, (1 - n.fast) * 23.398, 4.75, 1.381, 0, 17.0, 0, 0])


def outflow(n: Numbers, x: Matrix) -> tuple[float, float]:
    """Return the outflow of gas [L/d] and its slope in the pressure [L/(d bar)], at concentrations x [12]."""
    p = RT_CH4 * x[10] + RT_CO2 * x[11]
    return n.flow / n.p0 * (p - n.p0) * p, n.flow / n.p0 * (2 * p - n.p0)


def slopes(n: Numbers, x: Matrix, feed: float) -> Matrix:
    """Return the slope of dx/dt in x [12, 12], 1/d, at concentrations x [12] and a feed [L/d]."""
    q, dq = outflow(n, x)
    out = linear_part(n) - feed / n.Vl * np.diag(LIQUID)
    out[10:, 10:] -= (q * np.eye(2) + np.outer(x[10:], dq * np.array([RT_CH4, RT_CO2]))) / n.Vg
    return out


def rate_of(n: Numbers, x: Matrix, feed: float) -> Matrix:
    """Return dx/dt [12] in g/(L d) at concentrations x [12] and a feed [L/d]."""
    gas = np.append(np.zeros(10), x[10:])
    return linear_part(n) @ x + feed / n.Vl * (inlet(n) - LIQUID * x) - outflow(n, x)[0] / n.Vg * gas


@functools.cache
def operating_point(name: str) -> tuple[Matrix, float]:
    """Return concentrations at rest [12] in g/L and the feed [L/d] of a point, with the nominal constants (Newton's method)."""
    n, feed = Numbers(), FEEDS[name]
    x = np.array([0.01, 0.5, 1.0, 957.0, 2.0, 8.0, 1.0, 0.5, 2.0, 17.0, 0.4, 0.9])
    for _ in range(20):
        x = x - np.linalg.solve(slopes(n, x, feed), rate_of(n, x, feed))
    return x, feed


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the parameters of the equations."""
    n = numbers
    level, feed = operating_point(n.point)
    return Params(
        linear=linear_part(n),
        inlet=inlet(n),
        kla=np.asarray(n.kla),
        henry=np.array([n.Kch4 * RT_CH4 * 16, n.Kco2 * RT_CO2 * 44]),
        flow=np.asarray(n.flow / n.p0),
        p0=np.asarray(n.p0),
        Vl=np.asarray(n.Vl),
        Vg=np.asarray(n.Vg),
        level=level,
        feed=np.asarray(feed),
    )


def nominal(numbers: Numbers) -> Model:
    """Return the model linearised at the operating point, in seconds."""
    n = numbers
    x, feed = operating_point(n.point)
    _, dq = outflow(n, x)
    dry = RHO - x[3]
    C = np.zeros((6, 12))
    C[0, 10:] = dq * RT_CH4, dq * RT_CO2
    C[1, 10], C[2, 11], C[3, 2], C[4, 3] = RT_CH4, RT_CO2, 1.0, -1 / RHO
    C[5, 9], C[5, 3] = -1 / dry, -x[9] / dry**2
    B = (inlet(n) - LIQUID * x)[:, None] / n.Vl
    return Model(slopes(n, x, feed) / DAY, B / DAY, C)


def residual(numbers: Numbers) -> Matrix:
    """Return dx/dt at the operating point, [12] in g/(L s): 0 with the nominal constants."""
    rate = rate_of(numbers, *operating_point(numbers.point)) / DAY
    return np.where(np.abs(rate) > 1e-12, rate, 0.0)


def rates(params: Params, x: Float[Array, "12"], feed: Array) -> Float[Array, "12"]:
    """Return dx/dt [g/(L d)] at concentrations x [g/L] and a feed [L/d]."""
    p = RT_CH4 * x[10] + RT_CO2 * x[11]
    q = params.flow * (p - params.p0) * p
    outflow = jnp.concatenate([feed / params.Vl * (x[:10] - params.inlet[:10]), q / params.Vg * x[10:]])
    return params.linear @ x - outflow


def solve(params: Params, x: Float[Array, "12"], h: Array, b: Float[Array, "12"]) -> Float[Array, "12"]:
    """Return k with (I - GAMMA h A) k = b, A the slopes of the fast states at x alone; h in d."""
    a, (h1, h2) = GAMMA * h, params.henry
    p = RT_CH4 * x[10] + RT_CO2 * x[11]
    q, dq = params.flow * (p - params.p0) * p, params.flow * (2 * p - params.p0)
    transfer = a * params.kla
    to_gas = transfer * params.Vl / params.Vg / (1 + transfer)  # of the liquid's part, which is eliminated
    m11 = 1 + to_gas * h1 + a / params.Vg * (q + dq * RT_CH4 * x[10])
    m12 = a / params.Vg * dq * RT_CO2 * x[10]
    m21 = a / params.Vg * dq * RT_CH4 * x[11]
    m22 = 1 + to_gas * h2 + a / params.Vg * (q + dq * RT_CO2 * x[11])
    r1, r2 = b[10] + to_gas * b[0], b[11] + to_gas * b[1]
    det = m11 * m22 - m12 * m21
    g1, g2 = (m22 * r1 - m12 * r2) / det, (m11 * r2 - m21 * r1) / det
    l1, l2 = (b[0] + transfer * h1 * g1) / (1 + transfer), (b[1] + transfer * h2 * g2) / (1 + transfer)
    return jnp.concatenate([jnp.stack([l1, l2]), b[2:10], jnp.stack([g1, g2])])


def steps(params: Params, x: Float[Array, "12"], feed: Array, h: Array) -> Float[Array, "12"]:
    """Return x after the steps of a tick, h [d] each, under a feed [L/d]."""

    def rosenbrock_step(z: Array, _: None) -> tuple[Array, None]:
        k1 = solve(params, z, h, rates(params, z, feed))
        k2 = solve(params, z, h, rates(params, z + h * k1, feed) - 2 * k1)
        return z + h * (1.5 * k1 + 0.5 * k2), None

    return lax.scan(rosenbrock_step, params.level + x, None, STEPS)[0] - params.level


def successor(params: Params, now: Now, x: Float[Array, "12"], unknowns: Float[Array, "0"]) -> Float[Array, "12"]:
    """Return x one tick later under the held now.u; nothing is unknown."""
    return vmap_as_unit(steps)(params, x, params.feed + now.u[0], now.dt / DAY / STEPS)


def measured(params: Params, x: Float[Array, "12"]) -> Float[Array, "6"]:
    """Return the outputs at concentrations x [g/L]."""
    p1, p2 = RT_CH4 * x[10], RT_CO2 * x[11]
    p = p1 + p2
    return jnp.stack([params.flow * (p - params.p0) * p, p1, p2, x[2], 1 - x[3] / RHO, 1 - x[9] / (RHO - x[3])])


def sensor(params: Params, now: Now, x: Float[Array, "12"], unknowns: Float[Array, "0"]) -> Float[Array, "6"]:
    """Return the outputs as deviations; nothing is unknown."""
    return measured(params, params.level + x) - measured(params, params.level)


def step(params: Params, now: Now, x: Float[Array, "12"]) -> Float[Array, "12"]:
    """Advance x by one tick under the held now.u."""
    return successor(params, now, x, jnp.zeros(0))


def output(params: Params, now: Now, x: Float[Array, "12"]) -> Float[Array, "6"]:
    """Return the measured outputs as deviations."""
    return sensor(params, now, x, jnp.zeros(0))


PLANT = Plant(step, output)
