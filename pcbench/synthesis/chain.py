"""Gains of a chain of observers: one link for each distinct delay, from the sensor with the longest delay to the present.

Link i propagates an estimate over d_i = theta_i - theta_(i-1) samples. In state coordinates (T = I, F = inv(T) G T, K =
inv(T) L):

    A^d - F = K C,   yhat = W xhat + V ybar,   W = C A^d - V C                                (8), (9)

The error of a link is multiplied by F over d samples, and the map of the cascade is block triangular. It is stable if and
only if every rho(F_i) < 1, with the rate max rho(F_i)^(1/d_i) per sample. The certificate is the spectral radius of the map
of one sample in shift coordinates (newest first), which must equal that rate.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, Theorems 1 and 3, Algorithm 1. Different from print: T = I, because T has
nine free dimensions and its Sylvester equation is ill-conditioned here; (9) prints Q_0 = D - V D, which is wrong for D != 0.

`check` tests the paper's condition, one Lyapunov matrix for all links:

    (1 + e) F_i' P F_i + N_i (1 + 1/e) sum_{j > i} Phi_ij' P Phi_ij - P < 0   for every link i, N_i links before it     (29)
    Phi_ij = K_i U_i V_(i+1) U_(i+1) ... W_j,   U_i selects the channels that link i takes from the preceding link

It is for T_i = I of every link; in print the G_i are in the coordinates of their T_i. The condition is sufficient but not
necessary, because rho(F_i) < 1 decides. The paper computes e from norms. Here e is searched for, because norms depend on the
units of the states.
Source: Alipouri, Zhong, Actuators 2021, 10, 281, Theorem 3 and Appendix B. Remark 2, by which Theorem 2 with A_0 = 0 would be
necessary, certifies an unstable system and is not used.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import matrix_balance, solve_discrete_are

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.dynamics.observability import rank
from pcbench.errors import DesignError, first_sentence
from pcbench.synthesis import solvers
from pcbench.synthesis.certificate import Certificate, least_eigenvalue
from pcbench.synthesis.pole_placement import by_poles
from pcbench.synthesis.sampled_model import SampledPlant, invertible, noise_over, power, require_visible

MAX_ROWS = 600  # rows of the map of one sample; above, its radius is computed from the links


class Link(NamedTuple):
    """One link over d samples; n states, q outputs. A link with d = 0 passes its inputs on, and its gains are 0."""

    d: int
    has_arrived: Matrix  # [q] 1: the sample of the source has arrived; 0: it is from the preceding link
    F: Matrix  # [n, n]
    K: Matrix  # [n, q]
    V: Matrix  # [q, q]
    W: Matrix  # [q, n]


def ages(tau: tuple[int, ...]) -> list[int]:
    """Return theta: 0 and the sorted delays with repetitions, so that every delay vector gives q links."""
    return [0, *sorted(tau)]


def links(plant: SampledPlant, gain: str, pole: float, per_sample: bool, output: str, where: str) -> list[Link]:
    """Return a link for each channel, shortest delay first; `pole` is that of each link, or of each sample of a link."""
    theta, link_list = ages(plant.tau), []
    n, q = len(plant.A), len(plant.C)
    for start, end in pairwise(theta):
        d, has_arrived = end - start, np.array([float(tau <= end) for tau in plant.tau])
        if d == 0:
            zeros = np.zeros((n, n)), np.zeros((n, q)), np.zeros((q, q)), np.zeros((q, n))
            link_list.append(Link(0, has_arrived, *zeros))
            continue
        p = pole**d if per_sample else pole
        gain_of = by_companion if gain == "companion" else by_poles
        K = by_riccati(plant, d, where) if gain == "riccati" else gain_of(plant, d, p, where)
        Ad, C = power(plant.A, d), plant.C
        V = C @ K if output == "updated" else C @ Ad @ np.linalg.pinv(C)
        link_list.append(Link(d, has_arrived, Ad - K @ C, K, V, C @ Ad - V @ C))
    return link_list


def by_riccati(plant: SampledPlant, d: int, where: str) -> Matrix:
    """Return K = A^d P C'(C P C' + R)^-1 [n, q] of the stationary Kalman predictor over d samples."""
    require_visible(plant, d, where)
    Ad, C = power(plant.A, d), plant.C
    try:
        P = solve_discrete_are(Ad.T, C.T, noise_over(plant, d), plant.R)
        K = np.asarray(np.linalg.solve(C @ P @ C.T + plant.R, C @ P @ Ad.T).T, float)
        outcome = "F is stable" if spectral_radius(Ad - K @ C) < 1 else "its F is not stable"
    except (np.linalg.LinAlgError, ValueError) as error:
        outcome = f"SciPy reported '{first_sentence(error)}'"
    if outcome != "F is stable":
        raise DesignError(
            f"{where}: the Riccati equation over d = {d} samples has no stabilising solution ({outcome}), expected process "
            "noise on every mode that does not decay; give option q, or use gain = 'poles'."
        )
    return K


def companion(p: float, n: int) -> Matrix:
    """Return G [n, n] of (20) with an n-fold pole p: its last column holds s^n - g_n s^(n-1) - ... - g_1."""
    G = np.eye(n, k=-1)
    G[:, -1] = -np.poly([p] * n)[:0:-1]
    return G


def by_companion(plant: SampledPlant, d: int, pole: float, where: str) -> Matrix:
    """Return K [n, q] of the paper's companion G with T = C, so F = inv(C) G C; C must be invertible."""
    if not invertible(plant.C):
        raise DesignError(
            f"{where}: gain = 'companion' got C of shape {list(plant.C.shape)} and rank {rank(plant.C)}, "
            "expected an invertible one (T = C); use 'poles' or 'riccati'."
        )
    F = np.linalg.solve(plant.C, companion(pole, len(plant.A)) @ plant.C)
    return np.asarray((power(plant.A, d) - F) @ np.linalg.inv(plant.C), float)


def sample_map(chain: list[Link], C: Matrix) -> Matrix:
    """Return the map [n theta, n theta] of the errors over one sample, newest first, with theta the longest delay.

    Row g is the error of the state g samples ago, as estimated by the link whose range (stamp to source) contains g.
    """
    n, q = len(C[0]), len(C)
    theta = np.cumsum([0, *(link.d for link in chain)])
    blocks = theta[-1]
    J = np.eye(n * blocks, k=-n)
    eps = np.zeros((q, n * blocks))  # error of the preceding link's output, from the errors one sample ago
    for link, stamp, source in reversed(list(zip(chain, theta, theta[1:], strict=False))):
        if link.d == 0:
            continue
        selector = np.zeros((n, n * blocks))
        selector[:, n * (source - 1) : n * source] = np.eye(n)
        replacement = (1 - link.has_arrived)[:, None] * eps
        J[n * stamp : n * (stamp + 1)] = link.F @ selector + link.K @ replacement
        eps = link.W @ selector + link.V @ replacement
    return J


def rounding(F: Matrix, d: int) -> float:
    """Return a bound on the rounding error of the spectral radius of F [n, n], a map over d samples.

    An n-fold eigenvalue errs by about eps^(1/n) |F| (taken ten times, F balanced); raising the radius of the map of one
    sample to the power d adds n d eps.
    """
    eps, (balanced, _) = np.finfo(float).eps, matrix_balance(F)
    return float(10 * eps ** (1 / len(F)) * np.linalg.norm(balanced, 2) + eps * len(F) * d)


def certify(chain: list[Link], C: Matrix, method: str) -> Certificate:
    """Return 1 minus the radius of the map of one sample as margin; NaN if it differs from the radius of the links."""
    numbers: dict[str, float | Matrix]
    nonempty = [link for link in chain if link.d]
    rate = max(spectral_radius(link.F) ** (1 / link.d) for link in nonempty)
    exact = spectral_radius(sample_map(chain, C)) if len(C[0]) * sum(link.d for link in nonempty) <= MAX_ROWS else rate
    low, high = (
        max(max(spectral_radius(link.F) + sign * rounding(link.F, link.d), 0) ** (1 / link.d) for link in nonempty)
        for sign in (-1, 1)
    )
    is_consistent = low * (1 - 1e-6) <= exact <= high * (1 + 1e-6)
    numbers = {"radius_of_one_sample": exact, "largest_rho_F_to_1_over_d": rate}
    for i, link in enumerate(nonempty):
        numbers |= {f"{name}{i + 1}": getattr(link, name) for name in ("d", "F", "K", "V", "W")}
    margin = 1 - max(exact, rate) if is_consistent else float("nan")
    return Certificate("radius of the errors' map over one sample < 1", margin, method, "computed", numbers)


EXPONENT_RANGE = (-6.0, 3.0)  # of log10 e


def couplings(chain: list[Link]) -> list[list[Matrix]]:
    """Return Phi_ij [n, n] of every link i with d > 0, for each link j before it."""
    nonempty, rows = [link for link in chain if link.d], []
    for i, link in enumerate(nonempty):
        path, row = link.K * (1 - link.has_arrived), []
        for source_link in nonempty[i + 1 :]:
            row.append(path @ source_link.W)
            path = path @ source_link.V * (1 - source_link.has_arrived)
        rows.append(row)
    return rows


def check(
    chain: list[Link], scale: Matrix, solver_names: tuple[str, ...] = solvers.SOLVERS
) -> dict[str, float | Matrix]:
    """Search e for the largest t with (29) <= -t I and t I <= P <= I, at the scale of x(0); never raise an error.

    Returns `shared_margin`, checked by eigenvalues (positive: (29) holds; NaN: no answer), `shared_epsilon` and `shared_P`.
    """
    rows, change = couplings(chain), scale / scale[:, None]  # M for x becomes M for x / scale
    F = [link.F * change for link in chain if link.d]
    Phi = [[M * change for M in row] for row in rows]
    results: dict[float, tuple[float, Matrix]] = {}

    def loss(exponent: float) -> float:
        e = 10.0**exponent
        P = _solve(F, Phi, e, solver_names)
        results[e] = (float("nan"), P) if P.size == 0 else (_margin(F, Phi, e, P), P)
        return -results[e][0] if np.isfinite(results[e][0]) else 1.0

    from scipy.optimize import minimize_scalar  # takes a tenth of a second to import

    minimize_scalar(loss, bounds=EXPONENT_RANGE, method="bounded", options={"xatol": 0.05})
    e = max(results, key=lambda key: -np.inf if np.isnan(results[key][0]) else results[key][0])
    return {"shared_margin": results[e][0], "shared_epsilon": e, "shared_P": results[e][1]}


def _inequality(F: Matrix, Phi: list[Matrix], e: float, P: Any) -> Any:
    terms = [M.T @ P @ M for M in Phi]
    return P - (1 + e) * F.T @ P @ F - sum(len(Phi) * (1 + 1 / e) * term for term in terms)


def _solve(F: list[Matrix], Phi: list[list[Matrix]], e: float, solver_names: tuple[str, ...]) -> Matrix:
    import cvxpy as cp

    n = len(F[0])
    P, t = cp.Variable((n, n), symmetric=True), cp.Variable()
    constraints = [P << np.eye(n), P >> t * np.eye(n)]
    for M, row in zip(F, Phi, strict=True):
        form = _inequality(M, row, e, P)
        constraints.append((form + form.T) / 2 >> t * np.eye(n))
    for solver in solver_names:
        try:
            return solvers.minimise(-t, constraints, (P,), "(29)", solver, "none is needed")[1][0]
        except DesignError:
            continue
    return np.zeros((0, 0))


def _margin(F: list[Matrix], Phi: list[list[Matrix]], e: float, P: Matrix) -> float:
    margin = min(least_eigenvalue(_inequality(M, row, e, P)) for M, row in zip(F, Phi, strict=True))
    return min(margin, least_eigenvalue(P))
