"""Running planned cells: their seeds in calls of one width, and what each run leaves."""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.planning.padding import Planned, key_of
from pcbench.simulation import batch, metrics
from pcbench.simulation.problem import Outcome
from pcbench.study import Study

Results = dict[
    str, dict[str, NDArray[Any]]
]  # by observer, metric -> [what it estimates, seeds] ([seeds] for divergence)


class Done(NamedTuple):
    """A cell with what its runs left."""

    planned: Planned
    seeds: NDArray[np.int64]
    results: Results


def jobs(planned: Planned, root_seed: int, seeds: NDArray[np.int64]) -> Iterator[batch.Job]:
    """Cut a cell's seeds into jobs of one width."""
    for first in range(0, len(seeds), planned.layout.width):
        yield batch.Job(planned.problem, root_seed, seeds[first : first + planned.layout.width])


def results(planned: Planned, outcomes: Iterable[tuple[batch.Job, Outcome]]) -> Results:
    """Return the metrics that the outcomes of one cell's jobs hold, joined."""
    parts: dict[str, list[dict[str, NDArray[Any]]]] = {label: [] for label in planned.labels}
    n, tail, dt = planned.cell.times.ticks, planned.cell.times.tail, planned.cell.scenario.dt
    falls = bool((planned.problem.jumps < n).any())
    for _, outcome in outcomes:
        for label, (name, _) in zip(planned.labels, planned.layout.observers, strict=True):
            left = outcome.streams[name], outcome.watches[name], outcome.final[name]
            parts[label].append(metrics.read(*left, n, tail, dt, falls, outcome.tracking or None))
    return {label: {m: np.concatenate([p[m] for p in each], -1) for m in each[0]} for label, each in parts.items()}


def execute(
    study: Study,
    planned: list[Planned],
    seeds: NDArray[np.int64] | None = None,
    devices: int | None = None,
) -> Iterator[Done]:
    """Run every planned cell in this process and yield it, in memory, when its last run is in.

    `seeds` are seed indices, by default 0 .. study.seeds - 1. Cells of one shape come together, in their order.
    """
    chosen = np.arange(study.seeds) if seeds is None else np.asarray(seeds)
    groups: dict[Any, list[Planned]] = {}
    for p in planned:
        groups.setdefault(key_of(p), []).append(p)
    for group in groups.values():
        each = [list(jobs(p, study.root_seed, chosen)) for p in group]
        outcomes = batch.run(group[0].layout, [job for mine in each for job in mine], devices)
        for p, mine in zip(group, each, strict=True):
            yield Done(p, chosen, results(p, (next(outcomes) for _ in mine)))
