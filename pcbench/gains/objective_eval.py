"""Evaluation of the objective of a tuning, over training runs or as its expected value, and the choice of the optimizer.

The expected value is over all noise, without training and validation runs. It and its derivatives along the directions in
which free parameters change the gains are exact moments (`moments.gradients`). As for runs, the directions are central
differences of the observer's own design.
"""

from collections.abc import Callable

import jax
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from pcbench.dataset.seed_ranges import seed_range
from pcbench.engine import runner
from pcbench.errors import DigitsError, UserError
from pcbench.gains import optimizers
from pcbench.gains.history import Judgement
from pcbench.gains.objective import Objective
from pcbench.gains.parameters import Vector
from pcbench.moments import affinity, gradients, stats_rows
from pcbench.moments.exactness import refusal
from pcbench.moments.realisations import Realisation
from pcbench.planning import run_local
from pcbench.planning.padding import Plan
from pcbench.protocols import Gains
from pcbench.simulation.schedule.common_times import Schedule
from pcbench.statistics import POOLED

METHODS = ("descent", "search")
Evaluate = Callable[[Vector], tuple[float, Vector]]
SQUARES = {"mse": ("square", 0), "steady_mse": ("square", 1)}
SIZES = {"mae": ("absolute", 0), "steady_mae": ("absolute", 1)}
SUMS = SQUARES | SIZES  # field of `moments.error_sums`, and index: 0 over the horizon, 1 over the steady part
EXACT_METRICS = (*SUMS, *POOLED)
ADVICE = "tune on runs instead (exact_objective = false)"


def check_estimates(p: Plan, aim: Objective, where: str) -> None:
    """Raise UserError if the observer does not estimate the objective's signal."""
    ((label, observer),) = p.layout.observers
    shape = jax.eval_shape(
        lambda g, x: observer.estimate(g, observer.init(g, x)), p.problem.gains[label], p.problem.xhat0
    )
    if aim.signal >= shape.shape[0] + p.layout.plant.scored:
        raise UserError(
            f"{where}: --signal: got {aim.name}, which {p.labels[0]} does not estimate, expected one that it does; name "
            "another."
        )


def method_for(optimizer: str | None, aim: Objective, p: Plan, exact: bool, where: str) -> str:
    """Return "descent" if the objective has a gradient, as every exact objective has, otherwise "search".

    Raises UserError for descent without a gradient.
    """
    if optimizer not in (None, *METHODS):
        raise UserError(f"{where}: --optimizer: got '{optimizer}', expected {' or '.join(METHODS)}; leave it out.")
    obstacles = {
        f"{aim.metric} has no gradient": not aim.smooth,
        "its steps cannot be differentiated": not p.cell.entry(p.labels[0]).smooth,
        "each run has a schedule of its own": not isinstance(p.problem.schedule, Schedule),
        "a closed loop is not differentiated": p.layout.controller is not None,
    }
    reasons = [] if exact else [reason for reason, holds in obstacles.items() if holds]
    if optimizer == "descent" and reasons:
        raise UserError(f"{where}: --optimizer: got descent, but {reasons[0]}; expected search; leave it out.")
    return optimizer or ("search" if reasons else "descent")


def evaluator(
    method: str, p: Plan, aim: Objective, root_seed: int, seeds: NDArray[np.int64], design: Callable[[Vector], Gains]
) -> Evaluate:
    """Return a function that evaluates a point; it returns infinity if the gains are refused or a run diverges."""
    (label, _), *_ = p.layout.observers
    gradient = optimizers.value_and_gradient(p, aim, root_seed, seeds)

    def with_slope(at: Vector) -> tuple[float, Vector]:
        mean, slopes, has_diverged = gradient(design(at))
        if has_diverged:
            return float("inf"), np.full(len(at), np.nan)
        return aim.from_mean(mean), aim.slope(mean) * optimizers.chain(slopes, design, at)

    def value_only(at: Vector) -> tuple[float, Vector]:
        trial = p._replace(problem=p.problem._replace(gains={label: design(at)}))
        finished = runner.run(p.layout, list(run_local.jobs(trial, root_seed, seeds)))
        (metrics,) = run_local.results(trial, finished).values()
        return aim.from_runs(metrics[aim.base][aim.signal], metrics["diverged"]), np.zeros(0)

    def at(point: Vector) -> tuple[float, Vector]:
        try:
            return with_slope(point) if method == "descent" else value_only(point)
        except DigitsError:  # independent of the gains in an open loop, because of them in a closed one
            if p.layout.controller is None:
                raise
            return float("inf"), np.full(len(point), np.nan)
        except (UserError, ValidationError):  # the design refuses, or the option is invalid
            return float("inf"), np.full(len(point), np.nan)

    return at


def require_exact_value(aim: Objective, where: str) -> None:
    """Raise UserError if a metric never has an exact value."""
    if aim.metric not in EXACT_METRICS:
        reason = stats_rows.RUNS_ONLY.get(aim.metric, "it is of runs alone")
        raise UserError(
            f"{where}: --objective: got {aim.metric}, which has no exact value ({reason}), expected one of "
            f"{', '.join(EXACT_METRICS)}; write one of them, or {ADVICE}."
        )


def exact_cell(aim: Objective, p: Plan, where: str) -> Realisation:
    """Return the realisation of the cell for exact moments; raise UserError if its objective has no exact value."""
    require_exact_value(aim, where)
    if reason := affinity.refusal_beforehand(p):
        raise UserError(f"{where}: exact: {p.labels[0]} {reason}; {ADVICE}.")
    realisation = gradients.single_realisation(p)
    if realisation is None:
        raise UserError(
            f"{where}: exact: got runs with different schedules or plants, expected the same for all runs, as a gradient "
            f"is for one schedule; {ADVICE}."
        )
    if aim.metric in SIZES and (realisation.layout.scattered or realisation.chance < 1):
        raise UserError(
            f"{where}: --objective: got {aim.metric} of an error that is not normal (a start in a box, or a mixture over "
            f"losses), expected one of {', '.join((*SQUARES, *POOLED))}; write one of them, or {ADVICE}."
        )
    return realisation


def exact_evaluator(p: Plan, aim: Objective, count: int, design: Callable[[Vector], Gains], where: str) -> Evaluate:
    """Return a function that evaluates a point of `count` free parameters; it returns infinity without an exact value.

    It raises UserError if there is no exact value at the first point, which is a property of the observer, not of its gains.
    """
    call = gradients.build_gradients(p, exact_cell(aim, p, where), count)
    kind, part = SUMS[aim.base]
    tick_count = p.cell.times.ticks - (p.cell.times.tail if part else 0)
    points: list[Vector] = []

    def at(point: Vector) -> tuple[float, Vector]:
        failure = float("inf"), np.full(count, np.nan)
        try:
            moments = call(design(point), optimizers.directions(design, point))
        except (UserError, ValidationError):  # the design refuses, or the option is invalid
            return failure
        if reason := refusal(moments.cell, p.labels[0], ADVICE):
            if not points:
                raise UserError(f"{where}: exact: {reason}")
            return failure
        points.append(point)
        mean = float(getattr(moments.cell.sums, kind)[part, aim.signal, 0]) / tick_count
        slope = getattr(moments.slopes, kind)[part, aim.signal] / tick_count
        return aim.from_mean(mean), aim.slope(mean) * slope

    return at


def exact_judgement(aim: Objective, start: float, tuned: float) -> Judgement:
    """Return the expected values of start and tuned as a judgement, without seeds and errors."""
    a, b = aim.to_mean(start), aim.to_mean(tuned)
    return Judgement("exact", seed_range(0, 0), a, 0.0, b, 0.0, difference=b - a, difference_se=0.0, diverged=(0, 0))
