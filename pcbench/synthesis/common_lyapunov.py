"""One Lyapunov matrix for a whole range of sampling intervals, by LMI.

    [P, M(T)'; M(T), P] > 0,   M(T) = P J(T)            (the gain is given), or
                               M(T) = P J0(T) - Y H(T)  (it is sought: G = P^-1 Y, J = J0 - G H)

which is J(T)' P J(T) < P: the error falls in the norm of P over every interval, in whatever order the intervals come. The
solver sees a few T; the certificate is then re-checked by eigenvalues at every whole tick of the range, which are all that
can occur. The objective: maximise t subject to [P, M'; M, P] >= t I, P <= I.
Source: the design pages for Li, Wang, Tian (PI-PCO); that F(T) alone is stable, as printed, is not enough for PI-PCO.
"""

import warnings
from typing import NamedTuple

import numpy as np

from pcbench.errors import DesignError, said
from pcbench.synthesis.certificate import Certificate, least_eigenvalue
from pcbench.synthesis.linear import Matrix


class Solution(NamedTuple):
    """A solver's answer, as it came."""

    P: Matrix  # [k, k]
    G: Matrix  # [k, l]; of size 0 where the gain was given
    status: str
    solver: str


def solve(J: Matrix, H: Matrix | None, where: str, solver: str = "CLARABEL") -> Solution:
    """Find P for J [T, k, k], and with H [T, l, k] the gain G as well; raise DesignError where there is no answer."""
    import cvxpy as cp

    k = J.shape[1]
    P, t = cp.Variable((k, k), symmetric=True), cp.Variable()
    Y = None if H is None else cp.Variable((k, H.shape[1]))
    rules = [P << np.eye(k)]
    for i in range(len(J)):
        M = P @ J[i] if Y is None or H is None else P @ J[i] - Y @ H[i]
        rules.append(cp.bmat([[P, M.T], [M, P]]) >> t * np.eye(2 * k))
    problem = cp.Problem(cp.Maximize(t), rules)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an inaccurate answer is judged by its certificate
            problem.solve(solver=solver)
    except cp.SolverError as error:
        raise DesignError(
            f"{where}: got an LMI without an answer ({solver} said '{said(error)}'), expected one; narrow the intervals."
        ) from error
    if P.value is None or (Y is not None and Y.value is None):
        raise DesignError(
            f"{where}: got an LMI without a solution ({solver} said '{problem.status}'), expected one; narrow the intervals."
        )
    G = np.zeros((0, 0)) if Y is None else np.linalg.solve(P.value, np.asarray(Y.value))
    return Solution(P.value, G, str(problem.status), solver)


def certify(found: Solution, J: Matrix, what: str) -> Certificate:
    """Re-check [P, M'; M, P] > 0 at J [T, k, k], every interval that can occur; the least eigenvalue is the margin."""
    P = np.asarray(found.P, float)
    if P.shape != J.shape[1:]:
        return Certificate(what, float("nan"), found.solver, found.status)
    M, wide = P @ J, np.broadcast_to(P, J.shape)
    blocks = np.concatenate([np.concatenate([wide, M.transpose(0, 2, 1)], 2), np.concatenate([M, wide], 2)], 1)
    margin = min(float(np.linalg.eigvalsh(blocks).min()), least_eigenvalue(P))
    radius = float(np.abs(np.linalg.eigvals(J)).max())
    return Certificate(what, margin, found.solver, found.status, {"P": P, "largest_spectral_radius": radius})
