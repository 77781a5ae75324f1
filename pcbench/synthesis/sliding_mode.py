"""Gains of a sliding-mode observer by LMI: the least gains with a certified decay rate alpha.

    [ A11'P1 + P1 A11 - k1 A211 - A211'k1' + 2 alpha P1    A21'P2                     ]
    [ P2 A21                                               -k2 - k2' + 2 alpha P2     ]  <= 0             (23), (27)
    minimise r:   ||k1|| <= r,  ||k2|| <= r,  P1 >= I,  P2 >= I,   k1 = P1 L1,  k2 = -P2 A22s             (24), (29)

With v = 0 and f = 0, the error [ebar1; s], x' = [A11 - L1 A211, 0; A21, A22s] x, then decays as e^{-alpha t}. The observer
adds v = rho P2 s / (||P2 s|| + eps) (21), which needs this P2. Norms are spectral.
Source: Peng 2017, Proposition 1. Different from print: K1 and K2 are printed with zeros up to n rows and columns; if p - q >
n - p they overlap, which changes the norm. Here each norm is that of its own matrix.
Inequalities are not strict, because the optimum is on the boundary; `certify` checks what it proves. If A11 has a mode faster
than alpha, P1 may grow along it at no cost, and the printed minimum need not exist. Only then P1 <= 100 I is added, or the
first of BOUNDS with an answer.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError
from pcbench.synthesis import solvers, unknown_input
from pcbench.synthesis.certificate import Certificate
from pcbench.synthesis.unknown_input import Split

BOUNDS = (1e2, 1e4, 1e6, 1e8)  # upper bounds of P1 if it would be unbounded
ADVICE = "use a slower rate"


class SlidingModeGains(NamedTuple):
    """A solver's raw answer."""

    L1: Matrix  # [n-p, p-r]
    P1: Matrix  # [n-p, n-p]
    P2: Matrix  # [p, p]
    A22s: Matrix  # [p, p]
    r: float  # the largest of ||P1 L1|| and ||P2 A22s||
    status: str
    solver: str


def design(plant: Split, alpha: float, where: str) -> tuple[SlidingModeGains, Certificate]:
    """Return the least gains with the decay rate alpha [1/s], and their certificate; raise the errors of `solve`."""
    least = unknown_input.rate_to_certify(alpha)
    solution, certificate = solvers.solve_certified(
        partial(solve, plant, alpha, where), lambda solution: certify(solution, plant), where, least
    )
    return solution, unknown_input.require_rate(certificate, alpha, where)


def solve(plant: Split, alpha: float, where: str, solver: str = "CLARABEL") -> SlidingModeGains:
    """Return the least gains with the decay rate alpha [1/s], from the cache or a solver.

    Raises UserError if modes that no gain moves are slower than alpha, and DesignError if the solver has no answer.
    """
    unknown_input.require_movable(plant, alpha, where)
    problem = (plant.A11, plant.A21, plant.A211, np.array([alpha]))
    return solvers.solve_or_load(
        SlidingModeGains, "sliding-mode", problem, partial(_solve, plant, alpha, where), solver
    )


def closed_loop(plant: Split, L1: Matrix, A22s: Matrix) -> Matrix:
    """Return the map [n, n] of the error [ebar1; s] to its derivative without f and v."""
    A11b = plant.A11 - L1 @ plant.A211
    return np.block([[A11b, np.zeros_like(plant.A12)], [plant.A21, A22s]])


def certify(solution: SlidingModeGains, plant: Split) -> Certificate:
    """Check the LMI at the gains; the margin is the rate [1/s] that P1, P2 certify, NaN without one."""
    L1, P1, P2, A22s = (np.asarray(M, float) for M in solution[:4])
    inequality = "A'P + P A + 2 rate P <= 0, A = [A11 - L1 A211, 0; A21, A22s], P = blkdiag(P1, P2)"
    certificate = Certificate(inequality, float("nan"), solution.solver, solution.status)
    shapes = [(len(plant.A11), len(plant.A211)), plant.A11.shape, plant.A22.shape, plant.A22.shape]
    if [M.shape for M in (L1, P1, P2, A22s)] != shapes:
        return certificate
    margin = unknown_input.proven_rate(closed_loop(plant, L1, A22s), block_diag(P1, P2))
    if np.isnan(margin):
        return certificate
    r = float(max(np.linalg.norm(P1 @ L1, 2), np.linalg.norm(P2 @ A22s, 2)))
    numbers = {"L1": L1, "P1": P1, "P2": P2, "A22s": A22s, "r": r, "rate_proven": margin}
    return certificate._replace(margin=margin, numbers=numbers, rate=margin)


def _solve(plant: Split, alpha: float, where: str, solver: str) -> SlidingModeGains:
    has_fast_mode = np.linalg.eigvals(plant.A11).real.min() < -alpha
    *bounds, last = BOUNDS if has_fast_mode else (np.inf,)
    for bound in bounds:
        try:
            return _solve_with_bound(plant, alpha, bound, where, solver)
        except DesignError:
            continue
    return _solve_with_bound(plant, alpha, last, where, solver)


def _solve_with_bound(plant: Split, alpha: float, bound: float, where: str, solver: str) -> SlidingModeGains:
    import cvxpy as cp

    A11, A21, A211 = plant.A11, plant.A21, plant.A211
    k, p = len(A11), len(A21)
    P1, P2, r = cp.Variable((k, k), symmetric=True), cp.Variable((p, p), symmetric=True), cp.Variable()
    k1, k2 = cp.Variable((k, len(A211))), cp.Variable((p, p))
    diagonal1, diagonal2 = P1 @ A11 - k1 @ A211 + alpha * P1, alpha * P2 - k2
    M = cp.bmat([[diagonal1 + diagonal1.T, A21.T @ P2], [P2 @ A21, diagonal2 + diagonal2.T]])
    constraints = [M << 0, P1 >> np.eye(k), P2 >> np.eye(p), cp.sigma_max(k1) <= r, cp.sigma_max(k2) <= r]
    if np.isfinite(bound):
        constraints.append(P1 << bound * np.eye(k))
    unknowns = (P1, P2, k1, k2, r)
    status, (X1, X2, x1, x2, least) = solvers.minimise(r, constraints, unknowns, where, solver, ADVICE)
    L1, A22s = (np.asarray(np.linalg.solve(X, x), dtype=np.float64) for X, x in ((X1, x1), (X2, -x2)))
    return SlidingModeGains(L1=L1, P1=X1, P2=X2, A22s=A22s, r=float(least), status=status, solver=solver)
