"""One Lyapunov matrix for a whole range of sampling intervals, by LMI.

    [P, M(T)'; M(T), P] > 0,   M(T) = e^{rate T} P J(T)                (for a given gain), or
                               M(T) = e^{rate T} (P J0(T) - Y H(T))    (to compute it: G = P^-1 Y, J = J0 - G H)

This is J(T)' P J(T) < e^{-2 rate T} P: the error decreases in the norm of P over every interval, in every order of the
intervals, at that rate or faster. The solver uses a few T. The certificate is checked by eigenvalues at every whole tick of
the range, which are all intervals that can occur. The objective is to maximise t subject to [P, M'; M, P] >= t I, P <= I.
Source: this project's, after Li, Wang, Tian (PI-PCO), where only F(T) is stable, which does not suffice for PI-PCO.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.synthesis import error_bounds, solvers
from pcbench.synthesis.certificate import Certificate, least_eigenvalue


class CommonLyapunov(NamedTuple):
    """A solver's raw answer."""

    P: Matrix  # [k, k]
    G: Matrix  # [k, l]; empty for a given gain
    t: float
    status: str
    solver: str


class ErrorMaps(NamedTuple):
    """Maps J [k, n, n] of an error over intervals of `seconds` [k]; to compute a gain, those without it, and H [k, l, n]."""

    J: Matrix
    seconds: Matrix
    H: Matrix | None = None


def design(
    corners: ErrorMaps, maps_of: Callable[[CommonLyapunov], ErrorMaps], rate: float, inequality: str, where: str
) -> tuple[CommonLyapunov, Certificate]:
    """Return P (and G) computed at the `corners` of a range, certified at all maps that `maps_of` returns, at `rate` [1/s].

    Raises DesignError if no answer is certified.
    """
    J, H, name = corners.J, corners.H, "common-p" if corners.H is None else "common-g"
    problem = (J, corners.seconds, np.array(rate), np.zeros(0) if H is None else H)

    return solvers.solve_certified(
        partial(solvers.solve_or_load, CommonLyapunov, name, problem, partial(solve, corners, rate, where)),
        lambda solution: certify(solution, maps_of(solution), rate, inequality),
        where,
        hopeless=lambda solution: solution.status == "optimal" and solution.t <= 0,
    )


def solve(corners: ErrorMaps, rate: float, where: str, solver: str = "CLARABEL") -> CommonLyapunov:
    """Return P, and with H also the gain G; raise DesignError without an answer."""
    import cvxpy as cp

    J, H = np.exp(rate * corners.seconds)[:, None, None] * corners.J, corners.H
    k = J.shape[1]
    P, t = cp.Variable((k, k), symmetric=True), cp.Variable()
    Y = None if H is None else cp.Variable((k, H.shape[1]))
    constraints = [P << np.eye(k)]
    for i in range(len(J)):
        M = P @ J[i] if Y is None or H is None else P @ J[i] - np.exp(rate * corners.seconds[i]) * (Y @ H[i])
        constraints.append(cp.bmat([[P, M.T], [M, P]]) >> t * np.eye(2 * k))
    unknowns = (P, t) if Y is None else (P, t, Y)
    status, (X, least, *Z) = solvers.minimise(-t, constraints, unknowns, where, solver, "narrow the intervals")
    G = np.asarray(np.linalg.solve(X, Z[0]), dtype=np.float64) if Z else np.zeros((0, 0))
    return CommonLyapunov(X, G, float(least), status, solver)


def certify(solution: CommonLyapunov, maps: ErrorMaps, rate: float, inequality: str) -> Certificate:
    """Check [P, M'; M, P] > 0 at every map that can occur; the margin is the least eigenvalue."""
    P = np.asarray(solution.P, float)
    if P.shape != maps.J.shape[1:]:
        return Certificate(inequality, float("nan"), solution.solver, solution.status)
    M, P_all = np.exp(rate * maps.seconds)[:, None, None] * (P @ maps.J), np.broadcast_to(P, maps.J.shape)
    blocks = np.concatenate([np.concatenate([P_all, M.transpose(0, 2, 1)], 2), np.concatenate([M, P_all], 2)], 1)
    margin = min(float(np.linalg.eigvalsh(blocks).min()), least_eigenvalue(P))
    radius = spectral_radius(maps.J)
    rate_bound = error_bounds.rate(maps.J, P, maps.seconds)
    numbers = {"P": P, "largest_spectral_radius": radius}
    return Certificate(inequality, margin, solution.solver, solution.status, numbers, rate_bound)
