"""Gains and certificates of an observer that holds its innovations between aperiodic, asynchronous samples, by an LMI.

Clock g samples the outputs C_g; t_g is its newest sample and s_g = t - t_g <= T_g its age. A(t) is anywhere in the convex
hull of given matrices A_i, which contains the Jacobians of a nonlinear plant. The error obeys

    e' = A(t) e - sum_g L_g C_g e(t_g)
    V  = e'P e + sum_g (T_g - s_g) (integral of e^{2 a (r - t)} v(r)'R_g v(r) over r = t_g .. t),   v = de/dt

Let m_g be the mean of v since t_g, so that e(t_g) = e - s_g m_g. With Jensen's inequality, and 0 = 2 (e'P2' + v'P3')(e' - v),
dV/dt + 2 a V is at most a quadratic form in (e, v, m_g), affine in each s_g. It is negative if it is negative at all corners,
s_g = 0 or T_g at every A_i. V does not increase at a sample. So e decays at the rate a for all constant or varying intervals
up to T_g of each clock.

To compute a gain, P3 = ratio P2, so that the LMI is linear in P2'L_g. Time is in units of the largest T_g, and P <= I.
Source: Fridman, Automatica 46(2), 2010, for one clock and a given gain; several clocks and the hull are this project's.
Not claimed: that larger intervals are unstable, or any property with delayed samples.
"""

import itertools
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError
from pcbench.synthesis import solvers
from pcbench.synthesis.certificate import Certificate, least_eigenvalue

PRECISION = 1e-3  # relative, of the largest interval
UNKNOWN_GAIN = np.zeros((0, 0))  # a gain to be computed


class HeldTask(NamedTuple):
    """The error of an observer with q outputs on g clocks, and k matrices of the plant."""

    A: Matrix  # [k, n, n] corners of the plant [1/s]
    C: Matrix  # [q, n]
    clocks: tuple[int, ...]  # [q] the clock of each output, from 0
    intervals: tuple[float, ...]  # [g] the longest interval between samples of each clock [s]
    rate: float = 0.0  # a [1/s]
    ratio: float = 1.4  # P3 / P2 to compute a gain, in units of the largest interval


class HeldGain(NamedTuple):
    """A solver's raw answer, in units of the largest interval."""

    P: Matrix  # [n, n]
    R: Matrix  # [g, n, n]
    P2: Matrix  # [n, n]
    P3: Matrix  # [n, n]
    L: Matrix  # [n, q], multiplied by the largest interval
    t: float
    status: str
    solver: str


def corner_forms(task: HeldTask, P: Any, R: Any, W: tuple[Any, Any], Y: tuple[Any, Any]) -> list[list[list[Any]]]:
    """Return the blocks of the quadratic form in (e, v, m_g of the clocks with s_g = T_g) at each corner.

    The arguments are arrays or variables of cvxpy. W contains P2' and P3', and Y their products with L.
    """
    unit, n = max(task.intervals), task.A.shape[-1]
    rate, ages = task.rate * unit, [T / unit for T in task.intervals]
    outputs = [np.diag([float(clock == g) for clock in task.clocks]) @ task.C for g in range(len(ages))]
    forms = []
    for A, is_old_by_clock in itertools.product(task.A * unit, itertools.product((False, True), repeat=len(ages))):
        M2, M3 = (w @ A - y @ task.C for w, y in zip(W, Y, strict=True))
        fresh_R = sum(
            (age * r for age, r, is_old in zip(ages, R, is_old_by_clock, strict=True) if not is_old), np.zeros((n, n))
        )
        f12 = P - W[0] + M3.T
        rows = [[M2 + M2.T + 2 * rate * P, f12], [f12.T, fresh_R - W[1] - W[1].T]]
        for g in (g for g, is_old in enumerate(is_old_by_clock) if is_old):
            off_diagonal = [ages[g] * (y @ outputs[g]) for y in Y]
            for row, block in zip(rows, [*off_diagonal, *[np.zeros((n, n))] * (len(rows) - 2)], strict=True):
                row.append(block)
            diagonal = -ages[g] * np.exp(-2 * rate * ages[g]) * R[g]
            rows.append([row[-1].T for row in rows] + [diagonal])
        forms.append(rows)
    return forms


def solve(task: HeldTask, L: Matrix, where: str, solver: str = "CLARABEL") -> HeldGain:
    """Certify L [n, q], or compute a gain if L is UNKNOWN_GAIN, with the largest t; raise DesignError without an answer."""
    import cvxpy as cp

    n, q = task.A.shape[-1], len(task.C)
    P, t = cp.Variable((n, n), symmetric=True), cp.Variable()
    R = [cp.Variable((n, n), symmetric=True) for _ in task.intervals]
    P2 = cp.Variable((n, n))
    unit_L = max(task.intervals) * L
    if L.size:
        last = P3 = cp.Variable((n, n))
        Y = P2.T @ unit_L, P3.T @ unit_L
    else:
        last = cp.Variable((n, q))
        P3, Y = task.ratio * P2, (last, task.ratio * last)
    constraints = [P << np.eye(n), P >> t * np.eye(n), *(R_g >> t * np.eye(n) for R_g in R)]
    for form in map(cp.bmat, corner_forms(task, P, R, (P2.T, P3.T), Y)):
        constraints.append((form + form.T) / 2 << -t * np.eye(form.shape[0]))
    advice = "shorten the intervals, use a slower decay, or narrow the ranges"
    status, (X, margin, X2, Z, *S) = solvers.minimise(-t, constraints, (P, t, P2, last, *R), where, solver, advice)
    X3, gain = (Z, unit_L) if L.size else (task.ratio * X2, np.asarray(np.linalg.solve(X2.T, Z), float))
    return HeldGain(P=X, R=np.stack(S), P2=X2, P3=X3, L=gain, t=float(margin), status=status, solver=solver)


def certify(task: HeldTask, solution: HeldGain) -> Certificate:
    """Check P > 0, R_g > 0 and the form < 0 at every corner; the margin is the least eigenvalue minus its rounding error."""
    inequality = "V' + 2 a V < 0 at every corner of ages and models, V of Fridman 2010 with one term per clock"
    P, R, W2, W3, L = (
        np.asarray(array, float) for array in (solution.P, solution.R, solution.P2.T, solution.P3.T, solution.L)
    )
    if not all(np.isfinite(array).all() for array in (P, R, W2, W3, L)):
        return Certificate(inequality, float("nan"), solution.solver, solution.status)
    forms = [-np.block(rows) for rows in corner_forms(task, P, R, (W2, W3), (W2 @ L, W3 @ L))]
    margin = min(least_eigenvalue(M) - len(M) * np.finfo(float).eps * float(np.abs(M).sum()) for M in (P, *R, *forms))
    numbers = {"L": L / max(task.intervals), "P": P, "longest_intervals": np.array(task.intervals)}
    return Certificate(inequality, margin, solution.solver, solution.status, numbers, task.rate or float("nan"))


def design(task: HeldTask, L: Matrix | None, scale: Matrix, where: str) -> tuple[Matrix, Certificate]:
    """Return the gain [n, q] with its certificate: L itself, or a computed one if L is None.

    `scale` [n] are units of the states for the solver. Raises DesignError if no gain is certified.
    """
    unit_task = task._replace(A=task.A / scale[:, None] * scale, C=task.C * scale)
    unit_gain = UNKNOWN_GAIN if L is None else L / scale[:, None]
    arrays = (
        unit_task.A,
        unit_task.C,
        np.array(unit_task.clocks),
        np.array(unit_task.intervals),
        np.array([unit_task.rate, unit_task.ratio]),
        unit_gain,
    )

    solution, certificate = solvers.solve_certified(
        partial(solvers.solve_or_load, HeldGain, "held", arrays, partial(solve, unit_task, unit_gain, where)),
        lambda solution: certify(unit_task, solution),
        where,
        hopeless=lambda solution: solution.status == "optimal" and solution.t <= 0,
    )
    gain = scale[:, None] * np.asarray(solution.L, float) / max(task.intervals) if L is None else L
    numbers = dict(certificate.numbers) | {"L": gain, "P": np.asarray(solution.P) / np.outer(scale, scale)}
    return gain, certificate._replace(numbers=numbers)


def largest_interval(
    task: HeldTask, L: Matrix | None, upper: float, precision: float = PRECISION
) -> tuple[float, Certificate]:
    """Return the largest interval [s] of all clocks that the LMI certifies, up to `upper`, and its certificate.

    The intervals of `task` are not used; L as in `design`. `precision` is relative. Raises DesignError if no interval above
    this fraction of `upper` is certified.
    """
    low, high, best = 0.0, upper, None
    while high - low > precision * (low or upper):
        middle = (low + high) / 2
        trial = task._replace(intervals=(middle,) * len(task.intervals))
        try:
            certificate = certify(trial, solve(trial, UNKNOWN_GAIN if L is None else L, "the largest interval"))
        except DesignError:
            certificate = None
        if certificate and certificate.margin > 0:
            low, best = middle, certificate
        else:
            high = middle
    if best is None:
        raise DesignError("the largest interval: got no certified interval, expected one; give another gain.")
    return low, best
