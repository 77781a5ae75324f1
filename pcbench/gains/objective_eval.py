"""How the objective of a tuning is evaluated, and by which optimizer."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from pcbench.engine import runner
from pcbench.errors import DigitsError, UserError
from pcbench.gains import optimizers
from pcbench.gains.objective import Objective
from pcbench.gains.parameters import Vector
from pcbench.planning import run_local
from pcbench.planning.padding import Plan
from pcbench.simulation.schedule.common_times import Schedule

METHODS = ("descent", "search")
Evaluate = Callable[[Vector], tuple[float, Vector]]


def check_estimates(p: Plan, aim: Objective, where: str) -> None:
    """Raise UserError where the observer does not estimate the objective's signal."""
    ((label, observer),) = p.layout.observers
    found = jax.eval_shape(
        lambda g, x: observer.estimate(g, observer.init(g, x)), p.problem.gains[label], p.problem.xhat0
    )
    if aim.signal >= found.shape[0]:
        raise UserError(
            f"{where}: --signal: got {aim.name}, which {p.labels[0]} does not estimate, expected one that it does; name "
            "another."
        )


def method_for(asked: str | None, aim: Objective, p: Plan, where: str) -> str:
    """Return descent where there is a gradient, or else search; raise UserError where descent is asked for without one."""
    if asked not in (None, *METHODS):
        raise UserError(f"{where}: --optimizer: got '{asked}', expected {' or '.join(METHODS)}; leave it out.")
    against = {
        f"{aim.metric} has no gradient": not aim.smooth,
        "its steps cannot be differentiated": not p.cell.entry(p.labels[0]).smooth,
        "each run has a schedule of its own": not isinstance(p.problem.schedule, Schedule),
        "a closed loop is not differentiated": p.layout.controller is not None,
    }
    reasons = [reason for reason, holds in against.items() if holds]
    if asked == "descent" and reasons:
        raise UserError(f"{where}: --optimizer: got descent, but {reasons[0]}; expected search; leave it out.")
    return asked or ("search" if reasons else "descent")


def evaluator(
    how: str, p: Plan, aim: Objective, root_seed: int, seeds: NDArray[np.int64], design: Callable[[Vector], Any]
) -> Evaluate:
    """Return what evaluates a point: infinite where its gains are refused or a run diverges."""
    (label, _), *_ = p.layout.observers
    back = optimizers.backwards(p, aim, root_seed, seeds)

    def with_slope(at: Vector) -> tuple[float, Vector]:
        mean, slopes, lost = back(design(at))
        if lost:
            return float("inf"), np.full(len(at), np.nan)
        return aim.of(mean), aim.slope(mean) * optimizers.chain(slopes, design, at)

    def alone(at: Vector) -> tuple[float, Vector]:
        here = p._replace(problem=p.problem._replace(gains={label: design(at)}))
        (left,) = run_local.results(here, runner.run(p.layout, list(run_local.jobs(here, root_seed, seeds)))).values()
        return aim.over(left[aim.base][aim.signal], left["diverged"]), np.zeros(0)

    def at(point: Vector) -> tuple[float, Vector]:
        try:
            return with_slope(point) if how == "descent" else alone(point)
        except DigitsError:  # of an open loop whatever the gains, of a closed one because of them
            if p.layout.controller is None:
                raise
            return float("inf"), np.full(len(point), np.nan)
        except (UserError, ValidationError):  # its design refuses, or it is no option
            return float("inf"), np.full(len(point), np.nan)

    return at
