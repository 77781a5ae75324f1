"""Gains of a proportional-integral observer by LMI: the least gains with a certified decay rate beta.

With v = KP s + w, w' = KI s + xi sgn(s), and A22s = 0, the map of the error [ebar1; s; s'] is Ab - Bb K,

    Ab = [A11b, 0, 0; 0, 0, I; A21 A11b, 0, 0],  Bb = [0; 0; I],  K = [0, KI, KP],  A11b = A11 - L1 A211  (37), (39), (42)
    Q Ab' + Ab Q - LL'Bb' - Bb LL + 2 beta Q <= 0,   Q = inv(P) = blkdiag(Q1, [Q21, Q23; Q23, Q22])       (38), (40)
    minimise g:   ||LL|| <= g,  Q >= I,   LL = K Q = [0, LI, LP]                                          (52)

without xi sgn(s) and f', which act through Bb. Q21, Q22, Q23 are diagonal and Q23 <= 0. Then P has the same form with P23 >=
0, which Proposition 2 needs for sgn(s), element by element. The first block column of LL is zero, because a gain on the
unmeasured ebar1 cannot be applied. The norm is spectral; g is printed as gamma.
Source: Peng 2017, Proposition 2. L1 is that of the sliding-mode observer. Not in print: A11b is a block of the map, so beta
must be below its slowest decay rate. Inequalities are not strict, see `sliding_mode`.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError
from pcbench.synthesis import solvers, unknown_input
from pcbench.synthesis.certificate import Certificate
from pcbench.synthesis.unknown_input import Split

ADVICE = "use a slower rate"


class PIGains(NamedTuple):
    """A solver's raw answer."""

    KP: Matrix  # [p, p]
    KI: Matrix  # [p, p]
    P: Matrix  # [n+p, n+p], of [ebar1; s; s']
    g: float  # ||K inv(P)||
    status: str
    solver: str


def design(plant: Split, L1: Matrix, beta: float, where: str) -> tuple[PIGains, Certificate]:
    """Return the least gains with the decay rate beta [1/s] for L1, and their certificate; raise the errors of `solve`."""
    solution, certificate = solvers.solve_certified(
        partial(solve, plant, L1, beta, where),
        lambda solution: certify(solution, plant, L1),
        where,
        unknown_input.rate_to_certify(beta),
    )
    return solution, unknown_input.require_rate(certificate, beta, where)


def solve(plant: Split, L1: Matrix, beta: float, where: str, solver: str = "CLARABEL") -> PIGains:
    """Return the least gains with the decay rate beta [1/s] for L1 [n-p, p-r], from the cache or a solver.

    Raises UserError if A11 - L1 A211 decays no faster than beta, and DesignError if the solver has no answer.
    """
    A11b = plant.A11 - L1 @ plant.A211
    least = -float(np.linalg.eigvals(A11b).real.max())
    if not beta < least:
        raise UserError(
            f"{where}: got a rate beta of {beta:.4g} 1/s, expected less than the {least:.4g} 1/s at which A11 - L1 A211 "
            "decays; use a slower beta or a faster L1."
        )
    problem = (A11b, plant.A21, np.array([beta]))
    return solvers.solve_or_load(PIGains, "pi-observer", problem, partial(_solve, A11b, plant.A21, beta, where), solver)


def closed_loop(plant: Split, L1: Matrix, KP: Matrix, KI: Matrix) -> Matrix:
    """Return the map [n+p, n+p] of [ebar1; s; s'] to its derivative without xi and f', Ab - Bb K."""
    Ab, Bb = _model_only(plant.A11 - L1 @ plant.A211, plant.A21)
    return Ab - Bb @ np.hstack([np.zeros_like(plant.A21), KI, KP])


def certify(solution: PIGains, plant: Split, L1: Matrix) -> Certificate:
    """Check the LMI at the gains; the margin is the rate [1/s] that P certifies, NaN if P does not have the required form."""
    KP, KI, P = (np.asarray(M, float) for M in solution[:3])
    inequality = "A'P + P A + 2 rate P <= 0, A = Ab - Bb K, P = blkdiag(P1, [P21, P23; P23, P22]), P23 >= 0"
    certificate, (p, k) = Certificate(inequality, float("nan"), solution.solver, solution.status), plant.A21.shape
    if [M.shape for M in (KP, KI, P)] != [(p, p), (p, p), (k + 2 * p, k + 2 * p)] or not _has_form(P, k, p):
        return certificate
    margin = unknown_input.proven_rate(closed_loop(plant, L1, KP, KI), P)
    if np.isnan(margin):
        return certificate
    K = np.hstack([np.zeros_like(plant.A21), KI, KP])
    g = float(np.linalg.norm(np.linalg.solve(P, K.T), 2))
    numbers = {"L1": L1, "KP": KP, "KI": KI, "P": P, "g": g, "rate_proven": margin}
    return certificate._replace(margin=margin, numbers=numbers, rate=margin)


def form(P1: Matrix, P21: Matrix, P23: Matrix, P22: Matrix) -> Matrix:
    """Return P [n+p, n+p] from P1 [n-p, n-p] and the diagonals [p] of its other blocks."""
    zero = np.zeros((len(P1), len(P21)))
    lower_rows = [[zero.T, np.diag(P21), np.diag(P23)], [zero.T, np.diag(P23), np.diag(P22)]]
    return np.block([[P1, zero, zero], *lower_rows])


def _has_form(P: Matrix, k: int, p: int) -> bool:
    """Return whether P has exactly the form that Proposition 2 needs."""
    blocks = ((0, 0), (0, 1), (1, 1))
    diagonals = [P[k + i * p : k + (i + 1) * p, k + j * p : k + (j + 1) * p].diagonal() for i, j in blocks]
    return np.array_equal(P, form(P[:k, :k], *diagonals)) and bool((diagonals[1] >= 0).all())


def _model_only(A11b: Matrix, A21: Matrix) -> tuple[Matrix, Matrix]:
    p, k = A21.shape
    Ab = np.zeros((k + 2 * p, k + 2 * p))
    Ab[:k, :k], Ab[k : k + p, k + p :], Ab[k + p :, :k] = A11b, np.eye(p), A21 @ A11b
    return Ab, np.vstack([np.zeros((k + p, p)), np.eye(p)])


def _solve(A11b: Matrix, A21: Matrix, beta: float, where: str, solver: str) -> PIGains:
    import cvxpy as cp

    (p, k), (Ab, Bb) = A21.shape, _model_only(A11b, A21)
    Q1, g = cp.Variable((k, k), symmetric=True), cp.Variable()
    q21, q23, q22 = cp.Variable(p), cp.Variable(p), cp.Variable(p)
    zero, diagonals = np.zeros((k, p)), (cp.diag(q21), cp.diag(q23), cp.diag(q22))
    Q = cp.bmat([[Q1, zero, zero], [zero.T, diagonals[0], diagonals[1]], [zero.T, diagonals[1], diagonals[2]]])
    LL = cp.Variable((p, 2 * p))
    half_form = Ab @ Q - Bb @ cp.hstack([zero.T, LL]) + beta * Q
    constraints = [half_form + half_form.T << 0, Q >> np.eye(k + 2 * p), q23 <= 0, cp.sigma_max(LL) <= g]
    unknowns = (Q1, q21, q23, q22, LL, g)
    status, (X1, a, b, c, gains, least) = solvers.minimise(g, constraints, unknowns, where, solver, ADVICE)
    # The inverse channel by channel, so that its blocks are diagonal to the bit; Q23 > 0 is a rounding error of the solver.
    b = np.minimum(b, 0.0)
    P1, det = np.asarray(np.linalg.inv(X1), dtype=np.float64), a * c - b**2
    P = form(P1, c / det, -b / det, a / det)
    K = gains @ P[k:, k:]  # [KI, KP]
    return PIGains(K[:, p:], K[:, :p], P, float(least), status, solver)
