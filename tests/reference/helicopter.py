"""A helicopter with two degrees of freedom under delayed control: plant, controller and loop, whole histories kept.

Plant, x = [pitch, yaw, pitch rate, yaw rate] in rad and rad/s, u in V, B = [Bth, Bps] in N m s/rad:           (37)-(40)
        M1 th'' = Ktt u1 + Ktp u2 - Bth th' - ml2 sin th cos th ps'^2 - mgl cos th,      M1 = Jth + ml2
        M2 ps'' = Kpt u1 + Kpp u2 - Bps ps' + 2 ml2 sin th cos th th' ps',               M2 = Jps + ml2 cos(th)^2
Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206; brackets count its equations, "page" is the project's
page on it. Its minus signs are lost in the text; those above follow from Euler-Lagrange.

Time: tick k is t = k h, h = 1 ms. At each tick, in this order: a sample arrives (taken at tick s = k - round(tau/h), every
`period` ticks from tick 0), the estimate z[k] is read, the command is computed, plant and observer take one RK4
step under the same held input u[k]. u[k] is the command at (k + 1/2) h - tau((k + 1/2) h), linear between ticks.
Before t = 0 the world is constant: a sample from there reads x(0), a command is the law at z(0) and the path's own time.

Arrays of a run are [tick, run, component]; a run is diverged once |z| > 1e6 or not finite, and is nan from then on.
Differs from print: the viscosities are in N m s/rad, not N/V.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray

H = 1e-3  # tick [s]
ML2, MGL = 1.3872 * 0.186**2, 1.3872 * 9.81 * 0.186
J = np.array([0.0384, 0.0432])
K = np.array([[0.204, 0.0068], [0.0219, 0.072]])  # [Ktt, Ktp; Kpt, Kpp]
B_TRUE = np.array([0.8, 0.318])
KP, KD, LIMIT = np.array([30.0, 150.0]), np.array([5.0, 1.0]), np.array([20.0, 15.0])
X0 = np.array([np.pi / 4, np.pi / 8, 0.2, 0.1])
Z0 = np.array([np.pi / 8, np.pi / 16, 0.5, 0.1, 0.0, 0.0])


def late(t: Array | float) -> Array:
    """Return the constant delay 0.025 s at t."""
    return np.full(np.shape(t), 0.025)


def varying(t: Array | float) -> Array:
    """Return the delay 0.03 + 0.015 sin 2t [s] at t."""
    return 0.03 + 0.015 * np.sin(2 * np.asarray(t))


def circle(t: float) -> Array:
    """Return Td, Td', Td'' [3, 2] of the paper's path (1 + 0.5 sin t, 1 - 0.5 cos t) at time t."""
    s, c = 0.5 * np.sin(t), 0.5 * np.cos(t)
    return np.array([[1 + s, 1 - c], [c, s], [-s, c]])


def still(Td: Array) -> Callable[[float], Array]:
    """Return the path which rests at Td [2]."""
    return lambda t: np.array([Td, np.zeros(2), np.zeros(2)])


class Scenario(NamedTuple):
    """delay(t) [s] of actuator and measurement; period [ticks]; path(t) [3, 2]; options; factor(t) [2] or [runs, 2] of B."""

    delay: Callable[[Array | float], Array] = late
    period: int = 200
    path: Callable[[float], Array] = circle
    feedforward: bool = False
    predictor: bool = False
    factor: Callable[[float], Array] = lambda t: np.ones(2)


class Observer(NamedTuple):
    """start(z0 [runs, 6]); jump(memory, sampling tick, y [runs, 2]); flow(memory, u [runs, 2]); estimate(memory) [runs, 6]."""

    start: Callable[[Array], Any]
    jump: Callable[[Any, int, Array], Any]
    flow: Callable[[Any, Array], Any]
    estimate: Callable[[Any], Array]


class Trace(NamedTuple):
    """x [N+1, runs, 4], z [N+1, runs, 6] and u [N+1, runs, 2], row k at tick k; u[k] is held over tick k."""

    x: Array
    z: Array
    u: Array


def inertia(pitch: Array) -> Array:
    """Return [M1, M2] [..., 2] in kg m^2."""
    M = np.empty((*np.shape(pitch), 2))
    M[..., 0], M[..., 1] = J[0] + ML2, J[1] + ML2 * np.cos(pitch) ** 2
    return M


def torque(pitch: Array, rates: Array, u: Array) -> Array:
    """Return the torques without friction [..., 2] in N m: thrust, velocity products and gravity."""
    c = np.cos(pitch)
    product = ML2 * np.sin(pitch) * c * rates[..., 1]
    out = u @ K.T
    out[..., 0] -= product * rates[..., 1] + MGL * c
    out[..., 1] += 2 * product * rates[..., 0]
    return out


def rhs(x: Array, u: Array, B: Array) -> Array:
    """Return dx/dt [..., 4] of the plant at x [..., 4], u [..., 2], B [..., 2]."""
    rates = x[..., 2:]
    return np.concatenate([rates, (torque(x[..., 0], rates, u) - B * rates) / inertia(x[..., 0])], axis=-1)


def model(z: Array, u: Array) -> Array:
    """Return dz/dt [..., 6] of z = (x, B) with B at rest."""
    return np.concatenate([rhs(z[..., :4], u, z[..., 4:]), np.zeros_like(z[..., 4:])], axis=-1)


def rk4(field: Callable[[float, Array], Array], t: float, x: Array, h: float = H) -> Array:
    """Return x(t + h) of one classical Runge-Kutta step of x' = field(t, x)."""
    k1 = field(t, x)
    k2 = field(t + h / 2, x + h / 2 * k1)
    k3 = field(t + h / 2, x + h / 2 * k2)
    k4 = field(t + h, x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def acts_at(t: Array, delay: Callable[[Array], Array]) -> Array:
    """Return sigma with sigma - delay(sigma) = t; the iteration contracts where |delay'| < 1."""
    sigma = t
    for _ in range(60):
        sigma = t + delay(sigma)
    return sigma


def feedforward(z: Array, goal: Array) -> Array:
    """Return u_ff [runs, 2]: the inverse dynamics at goal [3, 2], with the estimated viscosities z[:, 4:]."""
    Td, rate, acceleration = goal
    wanted = inertia(Td[0]) * acceleration + z[:, 4:] * rate - torque(Td[0], rate, np.zeros(2))
    return wanted @ np.linalg.inv(K).T


def law(z: Array, ahead: Array, now: Array, goal: Array, scenario: Scenario) -> Array:
    """Return the clipped command [runs, 2].

    PD at z against now = path(t); with `predictor` at ahead, z predicted to sigma, against goal = path(sigma).
    """
    state, aim = (ahead, goal) if scenario.predictor else (z, now)
    u = -KP * (state[:, :2] - aim[0]) - KD * (state[:, 2:4] - aim[1])
    return np.clip(u + (feedforward(z, goal) if scenario.feedforward else 0.0), -LIMIT, LIMIT)


def read(V: Array, row: float, newest: int) -> Array:
    """Return V at a fractional row, linear between rows; rows past `newest` are not yet decided and read as it."""
    i = int(np.floor(row))
    w = row - i
    return (1 - w) * V[min(i, newest)] + w * V[min(i + 1, newest)]


def predict(z: Array, k: int, V: Array, rows: Array, newest: int, sigma: float) -> Array:
    """Return z [runs, 6] at sigma: RK4 from tick k, tick by tick under the commands decided so far, the last step shorter."""
    while sigma - k * H > 1e-9:
        u = read(V, rows[k], newest)
        z = rk4(lambda t, z: model(z, u), 0.0, z, min(H, sigma - k * H))  # noqa: B023
        k += 1
    return z


def simulate(
    observer: Observer,
    ticks: int,
    scenario: Scenario = Scenario(),  # noqa: B008
    x0: Array = X0[None],
    z0: Array = Z0[None],
    noise: Array | None = None,
) -> Trace:
    """Run the loop for N ticks from x0 [runs, 4] and z0 [runs, 6]; noise [samples, runs, 2] in rad, row j of sample j."""
    delay, period, path, _, ahead_of_delay, factor = scenario
    runs, longest = len(x0), int(np.ceil(delay(np.arange(ticks + 1000) * H).max() / H))
    past = longest + 2
    middle = np.arange(ticks + past + 1) + 0.5  # in ticks; some past the end, for the prediction
    rows = past + middle - delay(middle * H) / H  # of V, whose row past + k is the command of tick k
    times = np.arange(-past, ticks + 1) * H
    sigma = acts_at(times, delay)
    age = np.floor(delay(times) / H + 0.5).astype(int)
    V = np.zeros((past + ticks + 1, runs, 2))
    x, z, u = (np.zeros((ticks + 1, runs, n)) for n in (4, 6, 2))
    x[0], memory = x0, observer.start(z0)
    for i in range(past):
        V[i] = law(z0, z0, path(times[i]), path(sigma[i]), scenario)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for k in range(ticks + 1):
            i = past + k
            if k % period == 0:
                y = x[max(k - age[i], 0), :, :2] + (0.0 if noise is None else noise[k // period])
                memory = observer.jump(memory, k - age[i], y)
            z[k] = observer.estimate(memory)
            ahead = predict(z[k], k, V, rows, i - 1, sigma[i]) if ahead_of_delay else z[k]
            V[i] = law(z[k], ahead, path(times[i]), path(sigma[i]), scenario)
            u[k] = read(V, rows[k], i)
            if k < ticks:
                x[k + 1] = rk4(lambda t, x: rhs(x, u[k], B_TRUE * factor(t)), k * H, x[k])  # noqa: B023
                memory = observer.flow(memory, u[k])
    return Trace(x, z, u)


def rmse(trace: Trace, start: int = 0) -> Array:
    """Return the root mean square of x - xhat over ticks start .. N-1 [runs, 4]."""
    return np.sqrt(np.mean((trace.x - trace.z[..., :4])[start:-1] ** 2, axis=0))


def settled(trace: Trace, B: Array = B_TRUE, band: float = 0.05) -> Array:
    """Return the time [s] from which each viscosity stays within the band about B [runs, 2]; inf where it does not."""
    outside = ~(np.abs(trace.z[..., 4:] - B) <= band * B)
    last = len(outside) - 1 - np.argmax(outside[::-1], axis=0)
    entered = np.where(outside.any(axis=0), (last + 1) * H, 0.0)
    return np.where(outside[-1], np.inf, entered)


def diverged(trace: Trace) -> Array:
    """Return which runs [runs] diverged: an estimate not finite or above 1e6."""
    return ~(np.abs(trace.z).max(axis=(0, 2)) <= 1e6)


def unconverged(trace: Trace, B: Array = B_TRUE) -> Array:
    """Return which runs [runs] are not diverged, but have a viscosity off by more than 5 % in the second half."""
    half = trace.z[len(trace.z) // 2 :, :, 4:]
    return ~diverged(trace) & (np.abs(half - B) > 0.05 * B).any(axis=(0, 2))


def random_initial_state(rng: np.random.Generator, runs: int) -> Array:
    """Return z(0) [runs, 6] = x(0) + U(-0.5, 0.5) in the states, 0 in the viscosities."""
    return np.hstack([X0 + rng.uniform(-0.5, 0.5, (runs, 4)), np.zeros((runs, 2))])
