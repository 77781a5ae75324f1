"""Gains of a current estimator with a guarantee over a whole range of maps Phi_i, by LMI in P > 0 and Y = P L.

    decay   [P, M_i'/r_i; M_i/r_i, P] >= t I,  M_i = (P - Y C) Phi_i,  r_i = e^{-rate T_i},           maximise t <= 1 at P <= I
    h2      [P, M_i, (P - Y C) G_i, Y V; ., P, 0, 0; ., ., I, 0; ., ., ., I] >= 0,  [Z, W; W', P] >= 0,  minimise trace Z
    hinf    [P, M_i, (P - Y C) G_i, -Y V; ., P - W'W, 0, 0; ., ., g I, 0; ., ., ., g I] >= 0,         minimise g

with G_i G_i' = Q_i the process noise over an interval, V V' = R that of a sample, and W e the weighted error. h2 bounds the
covariance of W e by Z, and hinf its energy by g times that of the (normalised) noise. Each may be combined with decay. One P
for all is sufficient, not necessary. If the plant integrates, a constant sensor error causes the same constant error of the
estimate for every gain, which bounds the energy gain from below. The LMI is solved at the scale of the noise, and checked by
`error_bounds` in the plant's own units.
Source: standard (Boyd et al., Linear Matrix Inequalities in System and Control Theory, 1994; de Oliveira et al., 1999), in
the form that Y = P L makes affine.
"""

from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError
from pcbench.synthesis import error_bounds, riccati, solvers
from pcbench.synthesis.certificate import RATE_TOL, Certificate
from pcbench.synthesis.parameter_ranges import Maps

Kind = Literal["decay", "h2", "hinf"]
FASTEST = 5.0  # fastest decay, e^-5 per sample
ENERGY_FACTOR = 1.01  # factor of the least squared energy gain
STEPS = 24  # of the search for the fastest rate
ADVICE = "use a slower decay or a narrower range"


class RobustTask(NamedTuple):
    """Maps, noise and weights of a design; n states, q outputs."""

    maps: Maps
    C: Matrix  # [q, n]
    R: Matrix  # [q, q] variance of one sample, > 0
    W: Matrix  # [n, n] weight of the error
    scale: Matrix  # [n] size of the error, as units for the solver


class RobustGain(NamedTuple):
    """A solver's raw answer."""

    P: Matrix  # [n, n]
    L: Matrix  # [n, q]
    cost: float  # trace Z or g, in the solver's scale
    status: str
    solver: str


def design(
    task: RobustTask, kind: Kind, decay: float | None, where: str, solver_names: tuple[str, ...] = solvers.SOLVERS
) -> tuple[RobustGain, Certificate]:
    """Return a gain with its certificate; `decay` [1/s] is the least rate, None: any (for kind "decay": the fastest).

    Raises DesignError if no answer is certified.
    """
    if kind == "decay" and decay is None:
        return fastest(task, where)
    least = 0.0 if decay is None else decay * (1 - RATE_TOL)

    problem = (*task.maps.at_corners[:3], *task[1:], np.array(decay or 0.0))

    def hopeless(solution: RobustGain) -> bool:
        return kind == "decay" and solution.status == "optimal" and solution.cost >= 0

    return solvers.solve_certified(
        partial(solvers.solve_or_load, RobustGain, f"robust-{kind}", problem, partial(solve, task, kind, decay, where)),
        lambda solution: certify(solution, task, kind),
        where,
        least,
        hopeless,
        solver_names,
    )


def fastest(task: RobustTask, where: str) -> tuple[RobustGain, Certificate]:
    """Return the gain with the fastest decay that one P certifies over the range, by bisection of the rate."""
    low, high = 0.0, FASTEST / float(task.maps.seconds.min())
    best: tuple[RobustGain, Certificate] | None = None
    for _ in range(STEPS):
        if high - low < 1e-4 * high:
            break
        rate = (low + high) / 2
        try:
            best = design(task, "decay", rate, where, solvers.SOLVERS[:1])
            low = max(rate, best[1].rate)
        except DesignError:
            high = rate
    return best or design(task, "decay", 0.0, where)


def solve(task: RobustTask, kind: Kind, decay: float | None, where: str, solver: str = "CLARABEL") -> RobustGain:
    """Solve the inequalities at the corners of a range; raise DesignError without an answer.

    For hinf, many gains have nearly the least energy gain; of those up to ENERGY_FACTOR times it, the result has the least
    covariance.
    """
    if kind != "hinf":
        return _solve(task, kind, decay, np.inf, where, solver)
    least = _solve(task, kind, decay, np.inf, where, solver)
    return _solve(task, "h2", decay, ENERGY_FACTOR * least.cost, where, solver)


def _solve(task: RobustTask, kind: Kind, decay: float | None, energy: float, where: str, solver: str) -> RobustGain:
    """Minimise the objective of `kind`, with an energy gain of at most `energy`."""
    import cvxpy as cp

    S, v = task.scale, 1 / np.sqrt(np.diag(task.R))
    C = v[:, None] * task.C * S
    W = task.W * S
    W = W / np.linalg.norm(W)
    n, q = len(S), len(C)
    P, Y, cost = cp.Variable((n, n), symmetric=True), cp.Variable((n, q)), cp.Variable()
    constraints: list[cp.Constraint] = []
    P_YC = P - Y @ C
    for Phi, Q, T in zip(*task.maps.at_corners[:3], strict=True):
        M, G = P_YC @ (Phi / S[:, None] * S), P_YC @ riccati.root(Q / S[:, None] / S)
        if decay is not None or kind == "decay":
            N = np.exp((decay or 0.0) * T) * M
            constraints.append(cp.bmat([[P, N.T], [N, P]]) >> (-cost * np.eye(2 * n) if kind == "decay" else 0))
        if kind == "h2":  # of unit noise; with a finite energy gain that of P - W'W/g implies that of P
            constraints.append(_block(cp, P, M, G, Y, P - W.T @ W / energy, 1.0) >> 0)
        if kind == "hinf":
            constraints.append(_block(cp, P, M, G, Y, P - W.T @ W, cost) >> 0)
    if kind == "decay":
        constraints.append(P << np.eye(n))
    if kind == "h2":
        Z = cp.Variable((n, n), symmetric=True)
        constraints += [cp.bmat([[Z, W], [W.T, P]]) >> 0, cp.trace(Z) <= cost]
    status, (X, K, least) = solvers.minimise(cost, constraints, (P, Y, cost), where, solver, ADVICE)
    try:
        L = np.asarray(np.linalg.solve(X, K), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise DesignError(
            f"{where}: the LMI's P is singular ({solver} said '{status}'), expected P > 0; {ADVICE}."
        ) from None
    return RobustGain(X / S[:, None] / S, S[:, None] * L * v, float(least), status, solver)


def _block(cp: Any, P: Any, M: Any, G: Any, Y: Any, middle: Any, energy: Any) -> Any:
    """Return the block matrix of h2 or hinf for noise of variance 1."""
    n, q, r = P.shape[0], Y.shape[1], G.shape[1]
    zero = np.zeros
    return cp.bmat([
        [P, M, G, -Y],
        [M.T, middle, zero((n, r)), zero((n, q))],
        [G.T, zero((r, n)), energy * np.eye(r), zero((r, q))],
        [-Y.T, zero((q, n)), zero((q, r)), energy * np.eye(q)],
    ])  # fmt: skip


def certify(solution: RobustGain, task: RobustTask, kind: Kind) -> Certificate:
    """Check what P certifies for L at every map of the range; the margin is the decay rate [1/s]."""
    P, L = np.asarray(solution.P, float), np.asarray(solution.L, float)
    inequality = "F'P F <= e^{-2 rate T} P at every map of the range, F = (I - L C) Phi"
    if P.shape != task.W.shape or L.shape != task.C.T.shape or not (np.isfinite(P).all() and np.isfinite(L).all()):
        return Certificate(inequality, float("nan"), solution.solver, solution.status)
    maps = task.maps
    F, N = error_bounds.errors(L, task.C, maps.Phi), error_bounds.noise(L, task.C, maps.Q, task.R)
    rate = error_bounds.rate(F, P, maps.seconds)
    numbers: dict[str, object] = {"P": P, "L": L, "rate": rate, "maps": len(F)}
    if kind == "h2":
        inequality += "; X >= F X F' + noise, X = s inv(P)"
        X = task.W @ error_bounds.bound(F, N, P) @ task.W.T
        numbers |= {"rms_bound": float(np.sqrt(np.trace(X)))}
        rate = rate if np.isfinite(X).all() else float("nan")
    if kind == "hinf":
        inequality += "; sum |W e|^2 <= g^2 sum |noise|^2"
        I_LC = np.eye(len(L)) - L @ task.C
        B = np.stack([np.hstack([I_LC @ riccati.root(Q), -L @ riccati.root(task.R)]) for Q in maps.Q])
        g = error_bounds.gain_bound(F, B, task.W, P)
        numbers |= {"g": g}
        rate = rate if np.isfinite(g) else float("nan")
    return Certificate(inequality, rate, solution.solver, solution.status, numbers, rate)
