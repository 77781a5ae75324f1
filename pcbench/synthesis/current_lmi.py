"""Gain of a current estimator by LMI: xhat_m = xbar_m + L (y_m - C xbar_m), e_m = (I - L C) Phi e_(m-1).

    [-P, (P Phi - Y C Phi)'; P Phi - Y C Phi, -P] < 0,   L = P^-1 Y                          (23)

(23) is feasible for many L, so feasibility alone does not define a gain. Here t is maximised subject to

    [P, M'; M, P] >= t I,   P <= I,   M = P Phi - Y C Phi.

The optimum defines t and mostly P, but not Y: gains of two solvers, or of one on two machines, differ in the first digit. For
given P and t, the gains that attain t are those with ||D^-1/2 P (I - L C) Phi D^-1/2|| <= 1, D = P - t I. The result is the
one with the least Frobenius norm of that matrix,

    L = Phi D^-1 c (c' D^-1 c)^-1,   c = (C Phi)'.

With P = I it is argmin ||(I - L C) Phi||, t = 1 - ||(I - L C) Phi||, which needs no solver. If that attains the solver's
optimum, it is the result, so that no digit of a table depends on a solver. (The spectral norm leaves the gain undefined by
about the fast mode's e^{-lam te}.) For plants with several optimal P, the gain depends on the solver's P.
Source: Mohammed et al. 2017, Theorem 1; the objective is this project's.
"""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgWarning, solve_discrete_lyapunov

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.dynamics.observability import rank
from pcbench.synthesis import error_bounds, solvers
from pcbench.synthesis.certificate import Certificate, least_eigenvalue

OPTIMUM_TOL = 1e-5  # tolerance within which a gain attains a solver's optimum t
MIN_EIGENVALUE = 1e-9  # least eigenvalue of P - t I relative to the largest; smaller ones are raised to it


class CurrentGain(NamedTuple):
    """A solver's raw answer."""

    P: Matrix  # [n, n]
    L: Matrix  # [n, q]
    t: float
    status: str
    solver: str


def closed_form(Phi: Matrix, C: Matrix) -> Matrix:
    """Return argmin of ||(I - L C) Phi|| over L: L = Phi c (c'c)^-1, c = (C Phi)'; the least one for dependent outputs."""
    c = (C @ Phi).T
    if rank(c) < len(C):
        return np.asarray(Phi @ np.linalg.pinv(c.T), float)
    return np.asarray(np.linalg.solve(c.T @ c, c.T @ Phi.T).T, float)


def solve(Phi: Matrix, C: Matrix, where: str, solver: str = "CLARABEL") -> CurrentGain:
    """Solve the LMI with cvxpy; raise DesignError without an answer."""
    import cvxpy as cp

    if (r := rank(C)) < len(C):  # Y is not unique: solve for independent outputs, C = C M' M, and distribute their gain
        M = np.linalg.svd(C)[2][:r]
        solution = solve(Phi, M, where, solver)
        return solution._replace(L=solution.L @ np.linalg.pinv(C @ M.T))

    n, q = Phi.shape[0], C.shape[0]
    P, Y, t = cp.Variable((n, n), symmetric=True), cp.Variable((n, q)), cp.Variable()
    M = P @ Phi - Y @ (C @ Phi)
    block = cp.bmat([[P, M.T], [M, P]])
    constraints = [block >> t * np.eye(2 * n), P << np.eye(n)]
    status, (X, Z, least) = solvers.minimise(-t, constraints, (P, Y, t), where, solver, "try another period")
    return CurrentGain(X, np.asarray(np.linalg.solve(X, Z), dtype=np.float64), float(least), status, solver)


def lyapunov(Phi: Matrix, C: Matrix, L: Matrix) -> CurrentGain:
    """Return a given gain with P from M'P M - P = -I, M = (I - L C) Phi, scaled to P <= I."""
    F = error_bounds.errors(L, C, Phi)
    P = np.eye(len(Phi))
    if spectral_radius(F) < 1:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)  # an ill-conditioned P is judged by its certificate
            P = np.asarray(solve_discrete_lyapunov(F.T, P), dtype=np.float64)
        P = P / np.linalg.norm(P, 2)
    return CurrentGain(P, L, 0.0, "solved", "scipy")


def sharpen(solution: CurrentGain, Phi: Matrix, C: Matrix) -> CurrentGain:
    """Return the unique gain of the module's docstring; an answer that it cannot reproduce is returned as it is."""
    L, I, margin = closed_form(Phi, C), np.eye(len(Phi)), lmi_margin(solution, Phi, C)
    t = 1 - float(np.linalg.norm((I - L @ C) @ Phi, 2))
    if t > margin - OPTIMUM_TOL:
        return solution._replace(P=I, L=L, t=t)
    least = solution._replace(L=least_norm(solution, Phi, C)) if np.isfinite(margin) else solution
    return least if lmi_margin(least, Phi, C) > margin - OPTIMUM_TOL else solution


def least_norm(solution: CurrentGain, Phi: Matrix, C: Matrix) -> Matrix:
    """Return the gain of least norm that attains t with P: Phi D^-1 c (c' D^-1 c)^-1, D = P - t I."""
    size, V = np.linalg.eigh(solution.P - solution.t * np.eye(len(Phi)))
    root = V / np.sqrt(np.maximum(size, MIN_EIGENVALUE * size.max()))  # D^-1 = root root'
    return np.asarray(Phi @ root @ np.linalg.pinv(C @ Phi @ root), float)


def lmi_margin(solution: CurrentGain, Phi: Matrix, C: Matrix) -> float:
    """Return the t that an answer attains, independent of its status; minus infinity for wrong shapes."""
    P, L = np.asarray(solution.P, float), np.asarray(solution.L, float)
    if P.shape != Phi.shape or L.shape != C.T.shape or least_eigenvalue(np.eye(len(P)) - P) < -OPTIMUM_TOL:
        return -np.inf
    M = P @ (np.eye(len(P)) - L @ C) @ Phi
    return least_eigenvalue(np.block([[P, M.T], [M, P]]))


def certify(solution: CurrentGain, Phi: Matrix, C: Matrix, seconds: float) -> Certificate:
    """Check (23) with the gain itself: the margin is the least eigenvalue of [P, M'; M, P], M = P (I - L C) Phi.

    `seconds` is the time from sample to sample, for the decay rate.
    """
    P, L = solution.P, solution.L
    F = error_bounds.errors(L, C, Phi)
    M = P @ F
    block = np.block([[P, M.T], [M, P]])
    margin = min(least_eigenvalue(block), least_eigenvalue(P))
    numbers = {"P": P, "L": L, "eigenvalues": np.linalg.eigvals(F)}
    rate = error_bounds.rate(F[None], P, np.array([seconds]))
    return Certificate(
        "(23): [P, M'; M, P] > 0, M = P (I - L C) Phi", margin, solution.solver, solution.status, numbers, rate
    )
