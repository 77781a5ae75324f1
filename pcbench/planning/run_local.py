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

    planned: Plan
    seeds: NDArray[np.int64]
    results: Results


def jobs(planned: Plan, root_seed: int, seeds: NDArray[np.int64]) -> Iterator[runner.Job]:
    """Return the jobs of one width that cover a grid point's seeds."""
    each = planned.layout.defined and planned.cell.times.random
    for first in range(0, len(seeds), planned.layout.width):
        mine = seeds[first : first + planned.layout.width]
        schedules = [alone(planned, root_seed, int(seed)).problem.schedule for seed in mine] if each else None
        yield runner.Job(planned.problem, root_seed, mine, schedules and padding.stack_schedules(schedules))


def results(planned: Plan, outcomes: Iterable[tuple[runner.Job, RunSums]]) -> Results:
    """Return the joined metrics of one grid point's jobs; raise DigitsError if rounding decides them."""
    parts: dict[str, list[statistics.Results]] = {label: [] for label in planned.labels}
    n, tail, dt = planned.cell.times.ticks, planned.cell.times.tail, planned.cell.scenario.dt
    falls = bool((planned.problem.jumps < n).any())
    weights = planned.problem.weights
    costs = isinstance(weights, metrics.Weights) and np.size(weights.Q1) > 0
    for _, outcome in outcomes:
        digits.require(planned, outcome)
        for label, (name, _) in zip(planned.labels, planned.layout.observers, strict=True):
            left = outcome.streams[name], outcome.watches[name], outcome.final[name]
            effort, squares = outcome.effort or None, outcome.consistency.get(name) if outcome.consistency else None
            tracking, sent = outcome.tracking or None, outcome.sent if planned.problem.trigger else None
            parts[label].append(metrics.read(*left, n, tail, dt, falls, tracking, effort, costs, squares, sent))
    return {label: {m: np.concatenate([p[m] for p in each], -1) for m in each[0]} for label, each in parts.items()}


def execute(
    study: Study, planned: list[Plan], seeds: NDArray[np.int64] | None = None, devices: int | None = None
) -> Iterator[CellResults]:
    """Run every planned grid point in this process; yield its results, kept in memory, when its last run is complete.

    `seeds` are seed indices, by default 0 .. study.seeds - 1. Grid points of one shape are run together, in their order.
    """
    chosen = np.arange(study.seeds) if seeds is None else np.asarray(seeds)
    groups: dict[Hashable, list[Plan]] = {}
    for p in planned:
        groups.setdefault(key_of(p), []).append(p)
    for group in groups.values():
        each = [list(jobs(p, study.root_seed, chosen)) for p in group]
        outcomes = runner.run(group[0].layout, [job for mine in each for job in mine], devices)
        for p, mine in zip(group, each, strict=True):
            yield CellResults(p, chosen, results(p, (next(outcomes) for _ in mine)))
