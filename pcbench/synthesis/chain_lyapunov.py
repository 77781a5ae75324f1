"""The paper's condition for a chain: one Lyapunov matrix for all links.

    (1 + e) F_i' P F_i + N_i (1 + 1/e) sum_{j > i} Phi_ij' P Phi_ij - P < 0   for every link i, N_i links before it     (29)
    Phi_ij = K_i U_i V_(i+1) U_(i+1) ... W_j,   U_i picks the channels that link i takes from the link before

Checked at T_i = I for every link: in print the G_i stand in the coordinates of their T_i. It is sufficient at most and not
needed: the cascade is block triangular, so rho(F_i) < 1 decides. The paper sets e by norms; here it is searched
for, since norms of mixed units mean nothing.
Source: Alipouri, Zhong, Actuators 2021, 10, 281, Theorem 3 and Appendix B; Remark 2, which would make it necessary to use
Theorem 2 when A_0 = 0, certifies an unstable system and is not used.
"""

from typing import Any

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError
from pcbench.synthesis import solvers
from pcbench.synthesis.certificate import least_eigenvalue
from pcbench.synthesis.chain import Link

SPAN = (-6.0, 3.0)  # of log10 e


def couplings(chain: list[Link]) -> list[list[Matrix]]:
    """Return Phi_ij [n, n] of every link i that is not passed through, for each link j before it."""
    real, out = [link for link in chain if link.d], []
    for i, link in enumerate(real):
        path, each = link.K * (1 - link.seen), []
        for before in real[i + 1 :]:
            each.append(path @ before.W)
            path = path @ before.V * (1 - before.seen)
        out.append(each)
    return out


def check(chain: list[Link], scale: Matrix, among: tuple[str, ...] = solvers.SOLVERS) -> dict[str, Any]:
    """Search e for the largest t with (29) <= -t I and t I <= P <= I, at the scale of x(0); report, never refuse.

    Returns `shared_margin`, re-checked by eigenvalues (positive: (29) holds; NaN: no answer), `shared_epsilon`, `shared_P`.
    """
    rows, change = couplings(chain), scale / scale[:, None]  # M of x becomes M of x / scale
    F = [link.F * change for link in chain if link.d]
    Phi = [[M * change for M in each] for each in rows]
    found: dict[float, tuple[float, Matrix]] = {}

    def loss(exponent: float) -> float:
        e = 10.0**exponent
        P = _solve(F, Phi, e, among)
        found[e] = (float("nan"), P) if P.size == 0 else (_margin(F, Phi, e, P), P)
        return -found[e][0] if np.isfinite(found[e][0]) else 1.0

    from scipy.optimize import minimize_scalar  # takes a tenth of a second to import

    minimize_scalar(loss, bounds=SPAN, method="bounded", options={"xatol": 0.05})
    e = max(found, key=lambda key: -np.inf if np.isnan(found[key][0]) else found[key][0])
    return {"shared_margin": found[e][0], "shared_epsilon": e, "shared_P": found[e][1]}


def _inequality(F: Matrix, Phi: list[Matrix], e: float, P: Any) -> Any:
    coupled = [M.T @ P @ M for M in Phi]
    return P - (1 + e) * F.T @ P @ F - sum(len(Phi) * (1 + 1 / e) * term for term in coupled)


def _solve(F: list[Matrix], Phi: list[list[Matrix]], e: float, among: tuple[str, ...]) -> Matrix:
    import cvxpy as cp

    n = len(F[0])
    P, t = cp.Variable((n, n), symmetric=True), cp.Variable()
    rules = [P << np.eye(n), P >> t * np.eye(n)]
    for M, each in zip(F, Phi, strict=True):
        left = _inequality(M, each, e, P)
        rules.append((left + left.T) / 2 >> t * np.eye(n))
    for solver in among:
        try:
            return solvers.minimise(-t, rules, (P,), "(29)", solver, "none is needed")[1][0]
        except DesignError:
            continue
    return np.zeros((0, 0))


def _margin(F: list[Matrix], Phi: list[list[Matrix]], e: float, P: Matrix) -> float:
    worst = min(least_eigenvalue(_inequality(M, each, e, P)) for M, each in zip(F, Phi, strict=True))
    return min(worst, least_eigenvalue(P))
