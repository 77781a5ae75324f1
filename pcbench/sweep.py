"""Running planned cells: their seeds in blocks, cells of one shape through one program, and what each run leaves."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from pcbench import ensemble, metrics
from pcbench.planning import Planned, tail_tick, ticks
from pcbench.problem import Layout
from pcbench.study import Study


class Done(NamedTuple):
    """A cell with what its runs left: by observer, metric -> [what it estimates, seeds] ([seeds] for divergence)."""

    planned: Planned
    seeds: NDArray[np.int64]
    results: dict[str, dict[str, NDArray[Any]]]


def blocks(planned: Planned, root_seed: int, seeds: NDArray[np.int64]) -> Iterator[ensemble.Job]:
    """Cut a cell's seeds into jobs of one width."""
    for first in range(0, len(seeds), planned.layout.width):
        yield ensemble.Job(planned.problem, root_seed, seeds[first : first + planned.layout.width])


def execute(
    study: Study,
    planned: list[Planned],
    seeds: NDArray[np.int64] | None = None,
    devices: int | None = None,
    tell: Callable[[str, float], None] = lambda event, value: None,
) -> Iterator[Done]:
    """Run every planned cell and yield it when its last run is in.

    `seeds` are seed indices, by default 0 .. study.seeds - 1. `tell` hears ("compiled", seconds) and ("runs", how many).
    """
    chosen = np.arange(study.seeds) if seeds is None else np.asarray(seeds)
    waiting: dict[Place, list[Done]] = {}
    loops: dict[Place, list[str]] = {}
    for p in planned:
        loops.setdefault(_place(p), []).extend(p.labels)
    for layout, group in _by_layout(planned):
        jobs = [(p, job) for p in group for job in blocks(p, study.root_seed, chosen)]
        collected: dict[str, list[dict[str, NDArray[Any]]]] = {}
        made = ensemble.program(layout, jobs[0][1], devices)
        tell("compiled", made.compile_seconds)
        outcomes = ensemble.run(made, (job for _, job in jobs))
        for i, ((p, _), (job, outcome)) in enumerate(zip(jobs, outcomes, strict=True)):
            for label, (name, _) in zip(p.labels, layout.observers, strict=True):
                n, tail, dt = ticks(p.cell), tail_tick(p.cell), p.cell.scenario.dt
                left = outcome.streams[name], outcome.watches[name], outcome.final[name]
                read = metrics.read(*left, n, tail, dt, bool((p.problem.jumps < n).any()), outcome.tracking or None)
                collected.setdefault(label, []).append(read)
            tell("runs", len(job.seeds) * len(layout.observers))
            if i + 1 == len(jobs) or jobs[i + 1][0] is not p:
                done = Done(p, chosen, {label: _concatenate(parts) for label, parts in collected.items()})
                collected = {}
                if p.layout.controller is None:
                    yield done
                elif whole := _whole(done, waiting, loops):
                    yield whole


Place = tuple[str, int]  # a cell: its scenario's name, its number


def _place(p: Planned) -> Place:
    return p.cell.scenario.name, p.cell.number


def _whole(done: Done, waiting: dict[Place, list[Done]], loops: dict[Place, list[str]]) -> Done | None:
    """A cell with all of its observers: in a closed loop each has a program of its own, and the cell waits for the last."""
    place = _place(done.planned)
    labels, mine = loops[place], waiting.setdefault(place, [])
    mine.append(done)
    results = {label: found for part in mine for label, found in part.results.items()}
    if not all(label in results for label in labels):
        return None
    proofs = {label: c for part in mine for label, c in part.planned.certificates.items()}
    carries = {label: c for part in mine for label, c in part.planned.carries_input.items()}
    del waiting[place]
    planned = done.planned._replace(certificates=proofs, carries_input=carries)
    return Done(planned, done.seeds, {label: results[label] for label in labels})


def _by_layout(planned: list[Planned]) -> Iterator[tuple[Layout, list[Planned]]]:
    groups: dict[Any, list[Planned]] = {}
    for p in planned:
        leaves, tree = jax.tree.flatten(p.problem)
        groups.setdefault((p.layout, tree, tuple(np.shape(a) for a in leaves)), []).append(p)
    for (layout, *_), group in groups.items():
        yield layout, group


def _concatenate(parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([part[name] for part in parts], -1) for name in parts[0]}
