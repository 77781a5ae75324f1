"""The mobile cart: numbers, input, drift, closed-form gains, scenarios, and one call that runs it.

x = [position m, velocity m/s], x' = [[0, 1], [0, -lam]] x + [0, b]' u, y = position (30); tick 1 ms.
Source: Mohammed, Wang, Tian (2017), section 6; its equation numbers in brackets. Sign: u > 0 drives forward.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from . import linear

Array = np.ndarray

LAM = 122.0  # 1/s
GAIN = 355.0
TICK = 1e-3  # s
TICKS = 10_000
TAIL = 3_000  # tick from which the tail counts
X0 = np.array([5.0, 10.0])
XHAT0 = np.array([0.0, 0.0])
P0 = np.diag([25.0, 100.0])
INTENSITY = 0.002  # of the process noise on the input
EXACT_R = 1e-12  # what kf takes where measurements are exact

MODEL = linear.Model(np.array([[0.0, 1.0], [0.0, -LAM]]), np.array([[0.0], [GAIN]]), np.array([[1.0, 0.0]]), TICK)


class Scenario(NamedTuple):
    """te, d [ticks], standard deviation of a sample [m], KFBO's R, drift scale, kf's process noise q."""

    te: int
    d: int
    noise_std: float
    R: float
    drift: float = 0.0
    q: float = 0.0


SCENARIOS = {
    "cart/nominal": Scenario(200, 200, 0.0, 0.004),
    "cart/gaussian": Scenario(600, 600, 1.0, 1.0),
    "cart/gaussian-fast": Scenario(200, 600, 1.0, 1.0),
    "cart/white": Scenario(200, 200, np.sqrt(0.07 / 0.2), 0.004),
    "cart/drift": Scenario(200, 200, 0.0, 0.004, drift=1.0, q=INTENSITY),
    "cart/slow": Scenario(1000, 1000, 0.0, 0.3),
}


def sawtooth(ticks: int = TICKS, *, rising: bool = False) -> Array:
    """Return u [ticks+1, 1]: amplitude 10, period pi s; falling from +10 at t = 0, or rising from -10."""
    phase = np.array([(k * TICK / np.pi) % 1.0 for k in range(ticks + 1)])
    return (10 * (2 * phase - 1) if rising else 10 * (1 - 2 * phase))[:, None]


def drifting(t: float, scale: float, sign: float) -> tuple[float, float]:
    """Return A22(t), B21(t) of section 6.3; `scale` multiplies the deviation from -122 and 355."""
    A22 = -120 - (4 * np.sin(10 * t) + 20 * np.cos(t) * np.sin(t))
    B21 = 355 + 24 * np.cos(2 * t) + sign * 20 * np.sin(2 * t) * np.cos(2 * t)
    return -LAM + scale * (A22 + LAM), GAIN + scale * (B21 - GAIN)


def drift_step(scale: float, sign: float, substeps: int) -> Callable[[int, Array, Array], Array]:
    """Return plant_step(k, x, u): RK4 with `substeps` per tick; A22, B21 move within the tick, u does not."""
    h = TICK / substeps

    def field(t: float, x: Array, u: float) -> Array:
        A22, B21 = drifting(t, scale, sign)
        return np.array([x[1], A22 * x[1] + B21 * u])

    def step(k: int, x: Array, u: Array) -> Array:
        for i in range(substeps):
            t = k * TICK + i * h
            k1 = field(t, x, u[0])
            k2 = field(t + h / 2, x + h / 2 * k1, u[0])
            k3 = field(t + h / 2, x + h / 2 * k2, u[0])
            k4 = field(t + h, x + h * k3, u[0])
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return x

    return step


def transition(t: float) -> Array:
    """Return e^{At} [2, 2] for t seconds."""
    return np.array([[1.0, -np.expm1(-LAM * t) / LAM], [0.0, np.exp(-LAM * t)]])


def pccebo_gain(te: int) -> Array:
    """Return L [2, 1] = Phi c / (c'c), c = (C Phi)': the least ||(I - L C) Phi||_F; te in ticks."""
    Phi = transition(te * TICK)
    c = Phi[0]
    return (Phi @ c / (c @ c))[:, None]


def kfbo_gain(R: float) -> tuple[Array, Array]:
    """Return K [2, 1] and P [2, 2] of (26), (27) with R^-1 and Q = 0.002 B B'."""
    push = 2 * GAIN * np.sqrt(INTENSITY / R)
    K1 = push / (LAM + np.sqrt(LAM**2 + push))  # = -lam + sqrt(lam^2 + push), without its cancellation
    K2 = K1**2 / 2
    P = R * np.array([[K1, K2], [K2, K2 * (LAM + K1)]])
    return np.array([[K1], [K2]]), P


def process_covariance(t: float, q: float = INTENSITY) -> Array:
    """Return Qd [2, 2]: the covariance which noise of intensity q on the input adds in t seconds."""
    e1 = np.exp(-LAM * t)
    q22 = (1 - e1**2) / (2 * LAM)
    q12 = ((1 - e1) / LAM - q22) / LAM
    q11 = (t - 2 * (1 - e1) / LAM + q22) / LAM**2
    return q * GAIN**2 * np.array([[q11, q12], [q12, q22]])


def configure(
    scenario: str,
    te: int | None = None,
    d: int | None = None,
    drift: float | None = None,
    R: float | None = None,
) -> Scenario:
    """Return the scenario with te, d [ticks], drift scale, KFBO's R replaced where given; q stays."""
    given = {"te": te, "d": d, "drift": drift, "R": R}
    return SCENARIOS[scenario]._replace(**{name: value for name, value in given.items() if value is not None})


def observe(
    case: Scenario,
    observer: str,
    u: Array,
    samples: list[linear.Sample],
    xhat0: Array = XHAT0,
    *,
    lag_aware: bool = False,
    sampled_innovation: bool = False,
) -> Array:
    """Return xhat [N+1, 2] of `pccebo`, `kfbo`, `kf` or `model-only` with the gains of this case."""
    if observer == "pccebo":
        return linear.pccebo(MODEL, u, samples, xhat0, pccebo_gain(case.te))
    if observer == "kfbo":
        K = kfbo_gain(case.R)[0]
        flags = {"lag_aware": lag_aware, "sampled_innovation": sampled_innovation}
        return linear.kfbo(MODEL, u, samples, xhat0, K, case.te, case.d, **flags)
    if observer == "kf":
        variance = max(case.noise_std**2, EXACT_R)
        W = case.q * MODEL.B @ MODEL.B.T if case.q else None
        return linear.kf(MODEL, u, samples, xhat0, P0, np.array([variance]), W)
    if observer == "model-only":
        return linear.model_only(MODEL, u, xhat0)
    raise ValueError(f"no observer {observer!r}: choose pccebo, kfbo, kf or model-only")


def run(
    scenario: str,
    observer: str,
    *,
    noise: Array | None = None,
    te: int | None = None,
    d: int | None = None,
    drift: float | None = None,
    R: float | None = None,
    u: Array | None = None,
    x0: Array = X0,
    xhat0: Array = XHAT0,
    ticks: int = TICKS,
    sign: float = 1.0,
    substeps: int = 1,
    lag_aware: bool = False,
    sampled_innovation: bool = False,
) -> tuple[Array, Array]:
    """Return x, xhat [N+1, 2] of one run; noise [M] is added to the samples as it is (None: noise off).

    kf's R is the scenario's variance, also when the noise is off. `drift` 0 takes the exact step.
    """
    case = configure(scenario, te, d, drift, R)
    u = sawtooth(ticks) if u is None else u
    step = drift_step(case.drift, sign, substeps) if case.drift else None
    added = None if noise is None else [noise]
    x, samples = linear.simulate(MODEL, u, x0, [case.te], [case.d], added, step)
    flags = {"lag_aware": lag_aware, "sampled_innovation": sampled_innovation}
    return x, observe(case, observer, u, samples, xhat0, **flags)


def mae(e: Array, start: int = 0) -> Array:
    """Return mean |e| over the ticks start .. N-1; e [N+1, ...]."""
    return np.mean(np.abs(e[start:-1]), axis=0)


def rmse(e: Array, start: int = 0) -> Array:
    """Return the root of mean e^2 over the ticks start .. N-1; e [N+1, ...]."""
    return np.sqrt(np.mean(e[start:-1] ** 2, axis=0))


def peak(e: Array, start: int = 0) -> Array:
    """Return max |e| over the ticks start .. N-1; e [N+1, ...]."""
    return np.max(np.abs(e[start:-1]), axis=0)
