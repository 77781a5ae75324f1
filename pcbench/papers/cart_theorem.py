"""What the cart's paper prints of its theorem and its integral, re-checked in NumPy: (7), (8a), (23), Remarks 1 and 3.

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017), sections 3 to 6. Sampled every te with d = te.
"""

from math import exp, expm1, pi

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from pcbench.papers.claim import OPEN, Claim, statement
from pcbench.scenarios import SCENARIOS

LAM, B = 122.0, 355.0
C = np.array([[1.0, 0.0]])
SCALES = {"cart/nominal": "4.9499", "cart/slow": "4.9502"}


def theorem() -> list[Claim]:
    """Return what is printed of the inequality (23), and what it can and cannot guarantee."""
    out = []
    for scenario, printed in SCALES.items():
        te, P = SCENARIOS[scenario].sampling.sampling_period[0], float(printed) * np.eye(2)
        Y = float(printed) * C.T
        largest = float(np.linalg.eigvalsh(inequality(te, P, Y)).max())
        text = f"largest eigenvalue {largest:.4f}; inv(P) Y = {_row(np.linalg.solve(P, Y)[:, 0])}"
        claim = f"P = {printed} I, Y = [{printed}, 0]' satisfy (23), te = {te:g} s"
        out.append(statement(claim, "a feasible solution", text, largest < 0))
        half = float(np.linalg.eigvalsh(inequality(te, P / 2, Y / 2)).max())
        text = f"P / 2, Y / 2 are as good (largest eigenvalue {half:.4f}): only a scale"
        out.append(Claim(f"scale {printed} of P, te = {te:g} s", printed, text, OPEN))
    L, te = np.array([[1e-3], [0.0]]), 0.2
    F = transition(te) - L @ C @ transition(te)
    P = solve_discrete_lyapunov(F.T, np.eye(2))
    margin, radius = -float(np.linalg.eigvalsh(inequality(te, P, P @ L)).max()), float(max(abs(np.linalg.eigvals(F))))
    text = f"L = [0.001, 0]' is certified (margin {margin:.2g}) and keeps {100 * radius:.1f} % of the error a period"
    out.append(statement("Remark 1: (23) guarantees fast convergence", "fast", text, not (margin > 0 and radius > 0.9)))
    return [*out, _slower()]


def inequality(te: float, P: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Return the left side of (23), [4, 4]."""
    M = P @ transition(te) - Y @ C @ transition(te)
    return np.block([[-P, M.T], [M, -P]])


def transition(t: float) -> np.ndarray:
    """Return e^{At}."""
    return np.array([[1.0, -expm1(-LAM * t) / LAM], [0.0, exp(-LAM * t)]])


def _slower() -> Claim:
    """Remark 3: with R the slow pole of A - K C moves to the origin."""
    rates = {}
    for R in (0.004, 0.3, 1.0):
        K1 = -LAM + np.sqrt(LAM**2 + 2 * B * np.sqrt(0.002 / R))
        rates[R] = -max(np.linalg.eigvals(np.array([[-K1, 1.0], [-(K1**2) / 2, -LAM]])).real)
    text = "KFBO's slowest rate: " + ", ".join(f"{rate:.3g} 1/s at R = {R:g}" for R, rate in rates.items())
    falls = list(rates.values()) == sorted(rates.values(), reverse=True)
    return statement("Remark 3: the larger R, the slower KFBO", "slow response", text, falls)


def held_over_a_period(te: float = 0.2, horizon: float = 10.0) -> float:
    """Return PCCEBO's largest position error [m] from 1 s on where (8a) holds the input over a period, as it is written.

    With L = [1, 0]' the sampled position is exact; the velocity's error of a period's end shows until the next arrival.
    """
    ticks, dt = round(te / 1e-3), 1e-3
    u = np.array([10 * (1 - 2 * (k * dt / pi % 1.0)) for k in range(round(horizon / dt) + 1)])
    decay, e, worst = exp(-LAM * dt), 0.0, 0.0
    gain = B * (1 - decay) / LAM
    for first in range(0, len(u) - ticks, ticks):
        exact = held = 0.0
        for k in range(first, first + ticks):
            exact, held = decay * exact + gain * u[k], decay * held + gain * u[first]
        e = exp(-LAM * te) * e + exact - held
        if first * dt >= 1:
            worst = max(worst, abs(-expm1(-LAM * 2 * te) / LAM * e))
    return worst


def _row(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{v:g}" for v in values) + "]"
