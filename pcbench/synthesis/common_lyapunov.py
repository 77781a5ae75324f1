"""One Lyapunov matrix for a whole range of sampling intervals, by LMI.

    [P, M(T)'; M(T), P] > 0,   M(T) = e^{rate T} P J(T)                (the gain is given), or
                               M(T) = e^{rate T} (P J0(T) - Y H(T))    (it is sought: G = P^-1 Y, J = J0 - G H)

which is J(T)' P J(T) < e^{-2 rate T} P: the error falls in the norm of P over every interval, in whatever order the intervals
come, and at least at that rate. The solver sees a few T; the certificate is then re-checked by eigenvalues at every whole tick
of the range, which are all that can occur. The objective: maximise t subject to [P, M'; M, P] >= t I, P <= I.
Source: ours, after Li, Wang, Tian (PI-PCO): that F(T) alone is stable, as printed, is not enough for PI-PCO.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.synthesis import error_bounds, solvers
from pcbench.synthesis.certificate import Certificate, least_eigenvalue


class CommonLyapunov(NamedTuple):
    """A solver's answer, as it came."""

    P: Matrix  # [k, k]
    G: Matrix  # [k, l]; of size 0 where the gain was given
    t: float
    status: str
    solver: str


class ErrorMaps(NamedTuple):
    """The maps J [k, n, n] of an error over intervals of `seconds` [k]; where a gain is sought, without it, and H [k, l, n]."""

    J: Matrix
    seconds: Matrix
    H: Matrix | None = None


def design(
    corners: ErrorMaps, every: Callable[[CommonLyapunov], ErrorMaps], rate: float, what: str, where: str
) -> tuple[CommonLyapunov, Certificate]:
    """Find P (and G) at the `corners` of a range and prove it at all that `every` gives of an answer, at `rate` [1/s].

    Raises DesignError where no answer stands.
    """
    J, H, name = corners.J, corners.H, "common-p" if corners.H is None else "common-g"
    problem = (J, corners.seconds, np.array(rate), np.zeros(0) if H is None else H)

    def ask(solver: str) -> CommonLyapunov:
        return solvers.solve_or_load(
            CommonLyapunov, f"{name}-{solver.lower()}", problem, lambda: solve(corners, rate, where, solver)
        )

    return solvers.proven(
        ask,
        lambda found: certify(found, every(found), rate, what),
        where,
        hopeless=lambda found: found.status == "optimal" and found.t <= 0,
    )


def solve(corners: ErrorMaps, rate: float, where: str, solver: str = "CLARABEL") -> CommonLyapunov:
    """Find P, and with H the gain G as well; raise DesignError where there is no answer."""
    import cvxpy as cp

    J, H = np.exp(rate * corners.seconds)[:, None, None] * corners.J, corners.H
    k = J.shape[1]
    P, t = cp.Variable((k, k), symmetric=True), cp.Variable()
    Y = None if H is None else cp.Variable((k, H.shape[1]))
    rules = [P << np.eye(k)]
    for i in range(len(J)):
        M = P @ J[i] if Y is None or H is None else P @ J[i] - np.exp(rate * corners.seconds[i]) * (Y @ H[i])
        rules.append(cp.bmat([[P, M.T], [M, P]]) >> t * np.eye(2 * k))
    unknowns = (P, t) if Y is None else (P, t, Y)
    status, (X, least, *Z) = solvers.minimise(-t, rules, unknowns, where, solver, "narrow the intervals")
    G = np.asarray(np.linalg.solve(X, Z[0]), dtype=np.float64) if Z else np.zeros((0, 0))
    return CommonLyapunov(X, G, float(least), status, solver)


def certify(found: CommonLyapunov, every: ErrorMaps, rate: float, what: str) -> Certificate:
    """Re-check [P, M'; M, P] > 0 at every map that can occur; the least eigenvalue is the margin."""
    P = np.asarray(found.P, float)
    if P.shape != every.J.shape[1:]:
        return Certificate(what, float("nan"), found.solver, found.status)
    M, wide = np.exp(rate * every.seconds)[:, None, None] * (P @ every.J), np.broadcast_to(P, every.J.shape)
    blocks = np.concatenate([np.concatenate([wide, M.transpose(0, 2, 1)], 2), np.concatenate([M, wide], 2)], 1)
    margin = min(float(np.linalg.eigvalsh(blocks).min()), least_eigenvalue(P))
    radius = float(np.abs(np.linalg.eigvals(every.J)).max())
    proven = error_bounds.rate(every.J, P, every.seconds)
    numbers = {"P": P, "largest_spectral_radius": radius}
    return Certificate(what, margin, found.solver, found.status, numbers, proven)
