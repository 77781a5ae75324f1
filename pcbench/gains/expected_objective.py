"""The objective of a tuning as its expected value over all noise, with its gradient: no training runs, no judging runs.

Value and derivatives along the directions in which free parameters move the gains are exact moments (`moments.gradients`); the
directions come from the observer's own design by central differences, as those of `gradient` do.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import ValidationError

from pcbench.dataset.seed_ranges import counted
from pcbench.errors import UserError
from pcbench.gains import optimizers
from pcbench.gains.history import Judgement
from pcbench.gains.objective import Objective
from pcbench.gains.objective_eval import METHODS, Evaluate
from pcbench.gains.parameters import Vector
from pcbench.moments import gradients, stats_rows
from pcbench.moments.exactness import refusal
from pcbench.moments.realisations import Realised
from pcbench.planning.padding import Plan
from pcbench.statistics import POOLED

SQUARES = {"mse": ("square", 0), "steady_mse": ("square", 1)}
SIZES = {"mae": ("absolute", 0), "steady_mae": ("absolute", 1)}
SUMS = SQUARES | SIZES  # of `moments.error_sums`, and which of its two: over the horizon, or over the tail
OFFERED = (*SUMS, *POOLED)
INSTEAD = "leave exact out, and it is tuned on runs"


def offered(aim: Objective, where: str) -> None:
    """Raise UserError where a metric has no exact value, whatever the cell."""
    if aim.metric not in OFFERED:
        why = stats_rows.RUNS_ONLY.get(aim.metric, "it is of runs alone")
        raise UserError(
            f"{where}: --objective: got {aim.metric}, which has no exact value ({why}), expected one of {', '.join(OFFERED)}; "
            f"write one of them, or {INSTEAD}."
        )


def check(aim: Objective, p: Plan, where: str) -> Realised:
    """Return the cell as its moments move; raise UserError where its objective has no exact value."""
    offered(aim, where)
    one = gradients.single(p)
    if one is None:
        raise UserError(
            f"{where}: exact: got runs with schedules or plants of their own, expected what all runs share, as a gradient "
            f"is of one schedule; {INSTEAD}."
        )
    if aim.metric in SIZES and (one.layout.scattered or one.chance < 1):
        raise UserError(
            f"{where}: --objective: got {aim.metric} of an error that is not normal (a start in a box, or a mixture over "
            f"losses), expected one of {', '.join((*SQUARES, *POOLED))}; write one of them, or {INSTEAD}."
        )
    return one


def method_for(asked: str | None, where: str) -> str:
    """Return descent, or what is asked for: every exact objective has a gradient."""
    if asked not in (None, *METHODS):
        raise UserError(f"{where}: --optimizer: got '{asked}', expected {' or '.join(METHODS)}; leave it out.")
    return asked or "descent"


def evaluator(
    p: Plan, one: Realised, aim: Objective, many: int, design: Callable[[Vector], Any], where: str
) -> Evaluate:
    """Return what evaluates a point of `many` free parameters: infinite where its gains are refused, or nothing is exact.

    Raises UserError where nothing is exact at the first point: that is the observer's nature, not its gains'.
    """
    call, (kind, part) = gradients.sloped(p, one, many), SUMS[aim.base]
    count = p.cell.times.ticks - (p.cell.times.tail if part else 0)
    seen: list[Vector] = []

    def at(point: Vector) -> tuple[float, Vector]:
        lost = float("inf"), np.full(many, np.nan)
        try:
            found = call(design(point), optimizers.directions(design, point))
        except (UserError, ValidationError):  # its design refuses, or it is no option
            return lost
        if why := refusal(found.cell, p.labels[0], INSTEAD):
            if not seen:
                raise UserError(f"{where}: exact: {why}")
            return lost
        seen.append(point)
        mean = float(getattr(found.cell.sums, kind)[part, aim.signal, 0]) / count
        slope = getattr(found.slopes, kind)[part, aim.signal] / count
        return aim.of(mean), aim.slope(mean) * slope

    return at


def judgement(aim: Objective, start: float, tuned: float) -> Judgement:
    """Return start and tuned as their expected values: no seeds, no errors."""
    a, b = aim.mean(start), aim.mean(tuned)
    return Judgement(
        what="exact",
        seeds=counted(0, 0),
        start=a,
        start_se=0.0,
        tuned=b,
        tuned_se=0.0,
        difference=b - a,
        difference_se=0.0,
        diverged=(0, 0),
    )
