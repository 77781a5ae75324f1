"""Runs of a grid point without observers: states, measurements and arrival times."""

from collections.abc import Iterator
from math import isfinite
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pcbench import planning
from pcbench.engine import initial_state, lane_array
from pcbench.errors import UserError
from pcbench.planning import padding
from pcbench.planning.padding import Plan
from pcbench.simulation import trajectory
from pcbench.simulation.schedule import common_times, random_times
from pcbench.simulation.types import GridPointParams, Layout
from pcbench.study.grid import Cell

BATCH = 64  # runs per call
Floats = NDArray[np.float64]


class Run(NamedTuple):
    """One run, of N ticks."""

    seed: int
    x: Floats  # [N+1, n + s] the signals to estimate
    xhat0: Floats  # [n]
    samples: list[common_times.Sample]
    values: Floats  # [samples]


def plan_without_observers(cell: Cell) -> Plan:
    """Return a planned grid point without observers; raise UserError if external estimators cannot take part in it."""
    s = cell.scenario
    if s.loop.controller:
        raise UserError(
            f"{s.name}: got a closed loop, expected an open one: in a loop every observer has a plant of its own, and draws "
            "cannot be written before it estimates; export the controller's scenario with an input instead."
        )
    if s.sampling.continuous:
        raise UserError(
            f"{s.name}: got continuous measurement, expected samples; use a scenario with a sampling period."
        )
    if isfinite(speed := s.sampling.processor_speed):
        raise UserError(
            f"{s.name}: got processor_speed = {speed:g}, expected inf: the arithmetic of another program is not counted here; "
            "leave it out, and write a longer delay for its computing time."
        )
    (p,) = padding.fit(list(planning.drafts([cell], ())))
    return p


def runs(p: Plan, root_seed: int, seeds: NDArray[np.int64]) -> Iterator[Run]:
    """Yield the runs of a planned grid point; each has the same numbers as in the simulation."""
    for first in range(0, len(seeds), BATCH):
        yield from _run_batch(p, root_seed, seeds[first : first + BATCH])


def _run_batch(p: Plan, root_seed: int, seeds: NDArray[np.int64]) -> Iterator[Run]:
    n_ticks, n, q = p.cell.times.ticks, len(p.problem.x0), len(p.problem.noise_std)
    empty_schedule = common_times.schedule([], n_ticks, q)
    problem, root = p.problem._replace(schedule=empty_schedule), np.asarray(root_seed)
    layout = p.layout._replace(observers=(), consistency=False)
    x = np.asarray(trajectory.jit_record_some()(layout, 1, n_ticks + 1, problem, root, seeds).x)
    xhat0 = _starts(layout, problem, root, seeds)
    samples_by_run = [_samples(p, root_seed, int(seed)) for seed in seeds]
    times = [{tick: row for row, tick in enumerate(sorted({s.tick for s in samples}))} for samples in samples_by_run]
    ticks = np.zeros((len(seeds), max(map(len, times))), int)
    numbers = np.full((*ticks.shape, q), -1)
    for i, (rows, samples) in enumerate(zip(times, samples_by_run, strict=True)):
        ticks[i, : len(rows)] = np.maximum(list(rows), 0)
        for s in samples:
            numbers[i, rows[s.tick], s.channel] = s.number
    measure = trajectory.jit_measure_runs()
    y = np.asarray(measure(layout, problem, root, np.asarray(seeds), x[:, :n], ticks, numbers))
    for i, (rows, samples) in enumerate(zip(times, samples_by_run, strict=True)):
        values = np.array([y[i, rows[s.tick], s.channel] for s in samples])
        outcomes = [
            s._replace(arrives=common_times.NEVER) if np.isnan(v) else s for s, v in zip(samples, values, strict=True)
        ]
        yield Run(int(seeds[i]), x[..., i], xhat0[:, i], outcomes, values)


def _starts(layout: Layout, problem: GridPointParams, root: np.ndarray, seeds: NDArray[np.int64]) -> Floats:
    params, width = jax.tree.map(jnp.asarray, problem), len(seeds)
    xhat0 = initial_state.first_estimate(layout._replace(width=width), params, jnp.asarray(root), jnp.asarray(seeds))
    return np.asarray(lane_array.to_array(xhat0, width))


def _samples(p: Plan, root_seed: int, seed: int) -> list[common_times.Sample]:
    clocks, ticks = p.cell.times.clocks, p.cell.times.ticks
    if not p.cell.times.random:
        return [s for s in common_times.samples_of(clocks, ticks) if s.tick <= ticks]
    return random_times.draw_samples(clocks, ticks, len(p.problem.noise_std), root_seed, seed)
