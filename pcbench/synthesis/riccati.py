"""Riccati equations: the KFBO's stationary one, and the recursion that no causal estimator can beat.

    A P + P A' - P C' R^-1 C P + Q = 0,   K = P C' R^-1                                      (27), (26)

(26) is printed K = P C' R; the printed gains need R^-1. The printed Q = 0.001 I does not give them either: the process
noise enters through the input, Q = 0.002 B B'. Source: Mohammed et al. 2017, section 5.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_are

from pcbench.errors import DesignError
from pcbench.synthesis.certificate import Certificate, least_eigenvalue
from pcbench.synthesis.linear import Matrix, Model, over


class Stationary(NamedTuple):
    """A stationary Kalman filter in continuous time."""

    P: Matrix  # [n, n]
    K: Matrix  # [n, q]
    certificate: Certificate


def continuous(model: Model, Q: Matrix, R: Matrix, where: str) -> Stationary:
    """Solve (27) for P and K; the margin is how far A - K C lies left of the axis, NaN where P does not solve (27)."""
    A, _, C = model
    try:
        P: Matrix = np.asarray(solve_continuous_are(A.T, C.T, Q, R), dtype=np.float64)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise DesignError(
            f"{where}: the Riccati equation (27) was not solved: SciPy said '{error}'; "
            "(A, C) must be detectable and Q, R positive."
        ) from error
    K: Matrix = np.asarray(np.linalg.solve(R, C @ P).T, dtype=np.float64)
    residual = A @ P + P @ A.T - P @ C.T @ K.T + Q
    scale = np.abs(A @ P).max() + np.abs(Q).max()
    solved = least_eigenvalue(P) > 0 and np.abs(residual).max() < 1e-9 * scale
    poles = np.linalg.eigvals(A - K @ C)
    margin = float(-poles.real.max()) if solved else float("nan")
    numbers = {"P": P, "K": K, "poles": poles, "relative_residual": float(np.abs(residual).max() / scale)}
    return Stationary(P, K, Certificate("A - K C Hurwitz, (27) solved", margin, "scipy", "solved", numbers))


def update(P: Matrix, C: Matrix, R: Matrix) -> Matrix:
    """Return the posterior covariance (Joseph form) after a measurement y = C x + v, v ~ N(0, R)."""
    K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    keep = np.eye(len(P)) - K @ C
    return keep @ P @ keep.T + K @ R @ K.T


class Recursion(NamedTuple):
    """Covariances of the optimal filter at its own sampling times t_m, sample 0 included."""

    prior: Matrix  # [M, n, n]
    posterior: Matrix  # [M, n, n]


def recursion(E: Matrix, Q: Matrix, C: Matrix, R: Matrix, P0: Matrix, samples: int) -> Recursion:
    """Run P -> E P E' + Q -> update over `samples` samples, the first at t = 0 with the prior P0."""
    prior, posterior, P = [], [], P0
    for _ in range(samples):
        prior.append(P)
        posterior.append(update(P, C, R))
        P = E @ posterior[-1] @ E.T + Q
    return Recursion(np.stack(prior), np.stack(posterior))


def posterior_variance(
    doubled: Matrix, C: Matrix, R: Matrix, P0: Matrix, period: int, delay: int, ticks: int
) -> Matrix:
    """Return the variance [N, n] that no causal estimator can beat at ticks 0 .. N-1, without process noise.

    With x(0) ~ N(xhat0, P0) this is the Bayesian (posterior Cramer-Rao) bound: at tick k it uses every sample taken at or
    before k - delay. Source: Kalman; Van Trees. It exists only where R > 0.
    """
    E = over(doubled, period)
    after = recursion(E, np.zeros_like(P0), C, R, P0, ticks // period + 1).posterior
    tick = np.arange(ticks)
    newest = (tick - delay) // period  # the last sample known at each tick; negative: none
    gap = np.where(newest < 0, tick, tick - newest * period)
    powers = [np.eye(len(P0))]
    for _ in range(gap.max()):
        powers.append(doubled[0] @ powers[-1])
    F = np.stack(powers)[gap]
    P = np.where((newest < 0)[:, None, None], P0, after[newest])
    return np.einsum("kij,kij->ki", F @ P, F)
