"""A certificate for every real interval in a range [T1, T2]: one P with G(s)'P G(s) < P, also between grid points.

An error e is mapped from sample to sample by G(s) = E e^{F s} J, where s is any interval in the range, in any order:

    hold    e' = A e - L C e(t_k):                    F = [A, -L; 0, 0],  J = [I; C],  E = [I, 0]
    jump    e+ = (I - K C) e at a sample, e' = A e:   F = A,  J = I,  E = I - K C       (e after the jump)

P is computed for a few s. In the norm in which |e|^2 = e'P e, and in a cell of half-width w around m,

    |G(s)| <= |G(m)| + w |E F e^{F m} J| + |E F^2| |e^{F m} J| (e^{f w} - 1 - f w) / f^2,    f = |F|

If that is below 1 in every cell, the error decays for all real intervals of the range. The gain K of a jump is computed by the
same LMI, which is linear in P and P K.
Source: this project's. The theorems of Ferrante, Seuret (arXiv 2102.10652) were not obtained.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from pcbench.dynamics.linear import Matrix
from pcbench.synthesis import common_lyapunov
from pcbench.synthesis.certificate import Certificate
from pcbench.synthesis.common_lyapunov import ErrorMaps

SOLVER_INTERVALS = 25  # intervals that a solver sees
CELLS = 400  # cells of the range


class SampledError(NamedTuple):
    """G(s) = E e^{F s} J [n, n]; N states of the flow."""

    F: Matrix  # [N, N]
    J: Matrix  # [N, n]
    E: Matrix  # [n, N]


def held_error(A: Matrix, L: Matrix, C: Matrix) -> SampledError:
    """Return the error of an observer that holds its innovation."""
    n, q = L.shape
    F = np.block([[A, -L], [np.zeros((q, n + q))]])
    return SampledError(F, np.vstack([np.eye(n), C]), np.eye(n, n + q))


def jump_error(A: Matrix, K: Matrix, C: Matrix) -> SampledError:
    """Return the error, after the jump, of an observer whose estimate jumps by K (y - C xhat)."""
    return SampledError(A, np.eye(len(A)), np.eye(len(A)) - K @ C)


def maps_over(error: SampledError, seconds: Matrix) -> Matrix:
    """Return G(s) [k, n, n] at the intervals [k]."""
    return np.stack([error.E @ expm(error.F * s) @ error.J for s in seconds])


def jump_gain(A: Matrix, C: Matrix, low: float, high: float, where: str) -> Matrix:
    """Return a gain K [n, q] that one P proves at a few intervals of the range; raise DesignError if the LMI has none.

    The margin of the LMI is as large as possible. `certify` proves the gain over the whole range.
    """
    seconds = np.linspace(low, high, SOLVER_INTERVALS)
    Phi = np.stack([expm(A * s) for s in seconds])
    return common_lyapunov.solve(ErrorMaps(Phi, seconds, C @ Phi), 0.0, where).G


def certify(error: SampledError, low: float, high: float, where: str) -> Certificate:
    """Compute P, and bound |G(s)| over the range; the margin is 1 minus the bound. Raises DesignError without an answer."""
    seconds = np.linspace(low, high, SOLVER_INTERVALS)
    solution = common_lyapunov.solve(ErrorMaps(maps_over(error, seconds), seconds), 0.0, where)
    largest_norm = norm_bound(error, solution.P, low, high)
    inequality = f"|G(s)| < 1 for all s from {low:g} to {high:g} s, in the norm of P"
    numbers = {"P": solution.P, "largest_norm": largest_norm}
    return Certificate(inequality, 1 - largest_norm, solution.solver, solution.status, numbers)


def norm_bound(error: SampledError, P: Matrix, low: float, high: float, cells: int = CELLS) -> float:
    """Return a bound of |G(s)| over all s from `low` to `high` [s], in the norm of P [n, n]; NaN unless P > 0."""
    try:
        U = np.linalg.cholesky((P + P.T) / 2).T
    except np.linalg.LinAlgError:
        return float("nan")
    # units of the flow's states: those of e by U, those of a held innovation by |U|
    extra = len(error.F) - len(P)
    S = np.block([[U, np.zeros((len(P), extra))], [np.zeros((extra, len(P))), np.eye(extra) * np.linalg.norm(U, 2)]])
    F = S @ error.F @ np.linalg.inv(S)
    E, J = U @ error.E @ np.linalg.inv(S), S @ error.J @ np.linalg.inv(U)
    w, f = (high - low) / cells / 2, float(np.linalg.norm(F, 2))
    remainder = float(np.linalg.norm(E @ F @ F, 2)) * (np.expm1(f * w) - f * w) / f**2 if f else 0.0
    to_next, middles = expm(F * 2 * w), [expm(F * (low + w)) @ J]
    while len(middles) < cells:
        middles.append(to_next @ middles[-1])
    X = np.stack(middles)  # exp(F s) J in the middle of each cell
    norm_at_middle, slope, size = (np.linalg.norm(Y, 2, axis=(1, 2)) for Y in (E @ X, E @ F @ X, X))
    return float((norm_at_middle + w * slope + remainder * size).max())
