"""Intermittent observations: bounds of the expected covariance, critical arrival rates, and a finite buffer.

A measurement arrives with probability p. The expected covariance of the prediction lies between S = Q/(1 - (1 - p) a^2) and V,
the fixed point of V = a^2 V + Q - p a^2 V^2/(V + R). V is finite exactly if the linear matrix inequality of the paper is
feasible. That is so exactly if the recursion of V without Q and R, which is homogeneous, contracts.
"""

import numpy as np
from scipy.optimize import brentq

from pcbench.dynamics.linear import Matrix
from pcbench.papers.claim import Claim, all_digits, report_finding
from pcbench.plants import intermittent

COMPUTED = "Sinopoli et al. 2004 [V]"
BUFFER = "Schenato 2008 [V]"
A, Q, R = intermittent.Numbers().a, 1.0, 2.5
BOUNDS = {0.37: "64.0, 155.0", 0.4: "16.0, 39.51", 0.6: "2.667, 7.327", 1.0: "1.000, 3.18996"}
EXAMPLES = {
    "scalar a = 1.25": ("0.360", [[A]], [[1.0]]),
    "A = [1.25 1; 0 1.1], C = [1 1]": ("0.471", [[1.25, 1.0], [0.0, 1.1]], [[1.0, 1.0]]),
    "A = [1.25 1 0; 0 0.9 7; 0 0 0.6], C = [1 0 2]": (
        "0.360",
        [[1.25, 1.0, 0.0], [0.0, 0.9, 7.0], [0.0, 0.0, 0.6]],
        [[1.0, 0.0, 2.0]],
    ),
}
BUFFERS = {(0.2, 3): "0.488", (0.2, 2): "0.36", (0.3, 2): "0.51"}  # by rate of arrival per sample, and length


def rows() -> list[Claim]:
    """Return every claim on intermittent observations."""
    out = [all_digits("critical arrival rate, a = 1.25", "0.36", 1 - 1 / A**2, COMPUTED)]
    for p, printed in BOUNDS.items():
        out.append(all_digits(f"bounds S, V at an arrival rate of {p:g}", printed, bounds(p), COMPUTED))
    for name, (printed, matrix, sensor) in EXAMPLES.items():
        least = sufficient_rate(np.array(matrix), np.array(sensor))
        out.append(all_digits(f"least rate with a finite V: {name}", printed, least, COMPUTED))
    for (p, length), printed in BUFFERS.items():
        claim = f"samples within a buffer of {length}, geometric lateness with p = {p:g}"
        out.append(all_digits(claim, printed, 1 - (1 - p) ** length, BUFFER))
    exact = "Two samples at p = 0.2 give exactly the critical rate 0.36, and the expected covariance has no bound."
    return [*out, report_finding("intermittent observations: the shortest buffer", exact)]


def bounds(p: float, a: float = A, Q: float = Q, R: float = R) -> tuple[float, float]:
    """Return the bounds S, V of the expected covariance of a scalar plant at the arrival rate p above the critical one."""
    square = a**2 - 1 - p * a**2, (a**2 - 1) * R + Q, Q * R  # V (V + R) times V's equation
    return Q / (1 - (1 - p) * a**2), float(np.roots(square).real.max())


def sufficient_rate(A: Matrix, C: Matrix) -> float:
    """Return the least arrival rate at which V is finite: there the homogeneous recursion keeps its size."""
    return float(brentq(lambda p: _growth(A, C, p) - 1, 0.01, 0.99, xtol=1e-9))


def _growth(A: Matrix, C: Matrix, p: float, rounds: int = 400) -> float:
    """Return the growth per step of X+ = A X A' - p A X C' inv(C X C') C X A' in the limit."""
    X, size = np.eye(len(A)), 1.0
    for _ in range(rounds):
        gain = A @ X @ C.T
        X = A @ X @ A.T - p * gain @ np.linalg.solve(C @ X @ C.T, gain.T)
        size = float(np.trace(X))
        X = (X + X.T) / (2 * size)  # asymmetric rounding errors would grow
    return size
