"""Run planned grid points in this process: seeds in calls of one width, and the metrics of each run."""

from collections.abc import Hashable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench import statistics
from pcbench.engine import runner
from pcbench.planning import digits, padding
from pcbench.planning.build import alone
from pcbench.planning.padding import Plan, key_of
from pcbench.simulation import metrics
from pcbench.simulation.types import RunSums
from pcbench.study import Study

# by observer and metric: [signals, seeds], divergence [seeds]
Results = dict[str, statistics.Results]


class CellResults(NamedTuple):
    """The results of the runs of one grid point."""

    plan: Plan
    seeds: NDArray[np.int64]
    results: Results


def jobs(plan: Plan, root_seed: int, seeds: NDArray[np.int64]) -> Iterator[runner.Job]:
    """Return the jobs of one width that cover a grid point's seeds."""
    per_seed = plan.layout.by_definition and plan.cell.times.random
    for first in range(0, len(seeds), plan.layout.width):
        batch = seeds[first : first + plan.layout.width]
        schedules = [alone(plan, root_seed, int(seed)).problem.schedule for seed in batch] if per_seed else None
        yield runner.Job(plan.problem, root_seed, batch, schedules and padding.stack_schedules(schedules))


def results(plan: Plan, outcomes: Iterable[tuple[runner.Job, RunSums]]) -> Results:
    """Return the joined metrics of one grid point's jobs; raise DigitsError if rounding decides them."""
    parts: dict[str, list[statistics.Results]] = {label: [] for label in plan.labels}
    n, tail, dt = plan.cell.times.ticks, plan.cell.times.tail, plan.cell.scenario.dt
    has_jumps = bool((plan.problem.jumps < n).any())
    weights = plan.problem.weights
    has_cost = isinstance(weights, metrics.Weights) and np.size(weights.Q1) > 0
    for _, outcome in outcomes:
        digits.require(plan, outcome)
        for label, (name, _) in zip(plan.labels, plan.layout.observers, strict=True):
            sums = outcome.streams[name], outcome.watches[name], outcome.final[name]
            effort, squares = outcome.effort or None, outcome.consistency.get(name) if outcome.consistency else None
            tracking, n_sent = outcome.tracking or None, outcome.sent if plan.problem.trigger else None
            parts[label].append(
                metrics.finalize(*sums, n, tail, dt, has_jumps, tracking, effort, has_cost, squares, n_sent)
            )
    return {
        label: {m: np.concatenate([p[m] for p in batches], -1) for m in batches[0]} for label, batches in parts.items()
    }


def execute(
    study: Study, plans: list[Plan], seeds: NDArray[np.int64] | None = None, devices: int | None = None
) -> Iterator[CellResults]:
    """Run every planned grid point in this process; yield its results, kept in memory, when its last run is complete.

    `seeds` are seed indices, by default 0 .. study.seeds - 1. Grid points of one shape are run together, in their order.
    """
    indices = np.arange(study.seeds) if seeds is None else np.asarray(seeds)
    groups: dict[Hashable, list[Plan]] = {}
    for p in plans:
        groups.setdefault(key_of(p), []).append(p)
    for group in groups.values():
        job_lists = [list(jobs(p, study.root_seed, indices)) for p in group]
        outcomes = runner.run(group[0].layout, [job for point_jobs in job_lists for job in point_jobs], devices)
        for p, point_jobs in zip(group, job_lists, strict=True):
            yield CellResults(p, indices, results(p, (next(outcomes) for _ in point_jobs)))
