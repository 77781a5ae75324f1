"""Data for the figures of one run over time; the figures are `time_series.time` and `time_series.nees`.

The data are one run of a cell, thinned to few ticks, and bands of the errors of RUNS runs: its seed and those after it. They
are simulated again by the functions that made the tables. The folder `examples` next to the tables stores one file per
scenario, for the cell and seed that were shown last.
"""

import warnings
from collections.abc import Hashable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.planning import alone, drafts, padding
from pcbench.planning.padding import Plan
from pcbench.plants import entry_of, estimated_of, outputs_of_states
from pcbench.plots import example_cache
from pcbench.runtime import config, thread_pools
from pcbench.runtime.progress import SILENT, Progress
from pcbench.simulation import trajectory
from pcbench.simulation.trajectory import Trajectories
from pcbench.statistics import consistency
from pcbench.study import Study
from pcbench.study.grid import Cell, cells

FORM = 6  # of the file
ENDS = ("lowest", "highest")  # of an interval
POINTS = 120  # ticks that are kept, or up to twice as many
SIZES = {"abs_p05": 0.05, "abs_p25": 0.25, "abs_p50": 0.5, "abs_p75": 0.75, "abs_p95": 0.95}  # quantiles of |e|
MEDIAN = "abs_p50"
UNDER = "plant under "  # begins the series of the plant of each observer of a closed loop
RUNS = 32  # drawn if runs differ: nine in ten of their errors are in the band

Floats = NDArray[np.float64]


def frame_of(
    study: Study, scenario: str, out: str | Path | None, cell: int = 0, seed: int | None = None
) -> pd.DataFrame | None:
    """Return one run of a scenario as `of_scenarios` does."""
    return of_scenarios(study, {scenario: cell}, out, seed)[scenario]


def of_scenarios(
    study: Study, at: dict[str, int], out: str | Path | None, seed: int | None = None, progress: Progress = SILENT
) -> dict[str, pd.DataFrame | None]:
    """Return signal, series, kind, t [s], value of one run of each scenario, in its cell of `at`.

    Runs that are not in the folder `out` are simulated, all together, and stored there. `kind` is one of

    - truth: of the plant; in a closed loop, each observer has its own
    - estimate, error: of an observer; the error is truth minus estimate
    - low, high, rms, SIZES: the band of 90 % of the errors of RUNS runs, their rms, and quantiles of |e|
    - ENDS: of the interval of an observer with bounds
    - measured: the newest measurement, of a signal that is an output
    - arrival: of no signal, the rows in which the newest measurement changes
    - target: of a closed loop
    - sigma, and of no signal nees, nees_low, nees_high: in a study with consistency, the assumed standard deviation of this
      run, the mean NEES over RUNS runs, and its 95 % band if P is true

    A closed loop is frozen when it diverges: its truth, estimate and error are NaN from then on. Runs that do not differ, and
    those with random schedules, have no low, high and rms. None: the runs are not stored, and the code of a user's observer is
    not loaded. Raises UserError for a cell that the scenario does not have.
    """
    grid_cells = {scenario: _cell(study, scenario, number) for scenario, number in at.items()}
    seed = study.first_seed if seed is None else seed
    if not 0 <= seed < 2**32 - RUNS:
        raise UserError(f"--seed: got {seed}, expected a seed index of 0 or more, below 2^32 - {RUNS}.")
    about = [seed, POINTS, RUNS, FORM]
    entries = {scenario: example_cache.CacheEntry(scenario, cell, about) for scenario, cell in grid_cells.items()}
    runs = {scenario: example_cache.load_table(out, entry) for scenario, entry in entries.items()}
    missing = {name: t.cell for name, t in entries.items() if runs[name] is None and t.is_computable}
    for scenario, run in _simulate(missing, study.root_seed, seed, progress).items():
        runs[scenario] = example_cache.store(out, entries[scenario], run)
    return runs


def has_nees(run: pd.DataFrame) -> bool:
    """Return whether a frame of `frame_of` contains NEES."""
    return bool((run.kind == "nees").any())


def count_runs(run: pd.DataFrame) -> int:
    """Return the number of runs of the bands and means of a frame of `frame_of`: 1 if runs do not differ."""
    return RUNS if (run.kind == MEDIAN).any() else 1


def describe_seeds(run: pd.DataFrame, seed: int) -> str:
    """Return the number of runs of a frame of `frame_of` with their first seed, in words."""
    count = count_runs(run)
    return f"{count} runs from seed {seed}" if count > 1 else f"seed {seed}"


def _cell(study: Study, scenario: str, number: int) -> Cell:
    by_number = {c.number: c for c in cells(study, scenario)}
    if number not in by_number:
        raise UserError(
            f"--grid-point: got {number}, expected one of 0 .. {len(by_number) - 1}, the grid points of {scenario}; use "
            "one of these."
        )
    return by_number[number]


class Task(NamedTuple):
    """A plan to simulate: of all observers of an open loop, or of one of a closed loop."""

    plan: Plan  # its width is the number of seeds
    interval: int  # ticks from row to row
    rows: int
    seeds: NDArray[np.int64]  # [RUNS], or [1] where all runs are alike


def _simulate(at: Mapping[str, Cell], root_seed: int, seed: int, progress: Progress) -> dict[str, pd.DataFrame]:
    """Return the runs of a cell of each scenario, from `seed` on; programs are compiled in parallel."""
    if not at:
        return {}
    with config.float64():
        tasks = [_task(plan, root_seed, seed) for plan in padding.fit(list(drafts(list(at.values()))))]
    progress.begin("runs over time", len(tasks))
    groups: dict[Hashable, list[Task]] = {}  # by program, which is then made once
    for task in tasks:
        groups.setdefault((padding.key_of(task.plan), task.interval, task.rows), []).append(task)
    with thread_pools.pool(runner.cores()) as threads:
        work = [threads.submit(runner.in_float64, _record, group, root_seed) for group in groups.values()]
        trajectories: dict[int, Trajectories] = {}
        for group, future in zip(groups.values(), work, strict=True):
            trajectories |= {id(task): result for task, result in zip(group, future.result(), strict=True)}
            progress.step(len(group))
    parts: dict[str, list[pd.DataFrame]] = {scenario: [] for scenario in at}
    for task in tasks:
        series = parts[task.plan.cell.key[0]]
        series += list(_series(task, trajectories[id(task)], first=not series))
    return {scenario: pd.concat(frames, ignore_index=True) for scenario, frames in parts.items()}


def _task(plan: Plan, root_seed: int, seed: int) -> Task:
    p, layout, ticks = plan.problem, plan.layout, plan.cell.times.ticks
    has_noise = np.any(p.noise_std) and not layout.continuous
    is_random = layout.random_initial_state or layout.scattered or layout.drifting or layout.pending
    runs_differ = bool(has_noise or is_random or np.any(p.process_std)) and not plan.cell.times.random
    n_runs = RUNS if runs_differ else 1
    interval = -(-(ticks + 1) // (2 * POINTS)) if ticks >= POINTS else 1
    plan = alone(plan, root_seed, seed)
    plan = plan._replace(layout=plan.layout._replace(width=n_runs))
    return Task(plan, interval, ticks // interval + 1, np.arange(seed, seed + n_runs))


def _record(group: list[Task], root_seed: int) -> list[Trajectories]:
    """Return the runs of plans of one shape."""
    layout, interval, rows = group[0].plan.layout, group[0].interval, group[0].rows
    call = trajectory.jit_record_some()
    arguments = [jax.tree.map(np.asarray, (task.plan.problem, root_seed, task.seeds)) for task in group]
    return [jax.tree.map(np.asarray, call(layout, interval, rows, *numbers)) for numbers in arguments]


def _series(task: Task, trajectories: Trajectories, first: bool) -> Iterator[pd.DataFrame]:
    """Yield the series of one plan; `first` of its scenario."""
    plan, scenario = task.plan, task.plan.cell.scenario
    t, is_closed = task.interval * np.arange(task.rows) * scenario.dt, bool(scenario.loop.controller)
    names = dict(zip(plan.labels, (name for name, _ in plan.layout.observers), strict=True))
    outputs = outputs_of_states(scenario)
    plant = f"{UNDER}{plan.labels[0]}" if is_closed else "plant"
    rows = _rows_before_divergence(plan, trajectories) if is_closed else len(t)

    def moving(values: ArrayLike) -> Floats:
        return np.where(np.arange(len(t)) < rows, values, np.nan)

    def frame(signal: str, name: str, kind: str, values: ArrayLike) -> pd.DataFrame:
        return pd.DataFrame({"signal": signal, "series": name, "kind": kind, "t": t, "value": values})

    for i, (signal, _) in enumerate(estimated_of(scenario)):
        if first or is_closed:
            yield frame(signal, plant, "truth", moving(trajectories.x[:, i, 0]))
        for label, name in names.items():
            estimates = trajectories.estimates[name]
            if i >= estimates.shape[1]:
                continue
            error = trajectories.x[:, i] - estimates[:, i]
            yield frame(signal, label, "estimate", moving(estimates[:, i, 0]))
            yield frame(signal, label, "error", moving(error[:, 0]))
            for kind, values in _spread(error).items():
                yield frame(signal, label, kind, values)
            if name in trajectories.sigma:
                yield frame(signal, label, "sigma", trajectories.sigma[name][:, i, 0])
            for k, end in enumerate(ENDS if name in trajectories.bounds else ()):
                yield frame(signal, label, end, trajectories.bounds[name][:, k, i, 0])
        if first and i < trajectories.target.shape[1]:
            yield frame(signal, "set point", "target", trajectories.target[:, i])
        if signal in outputs and first and not is_closed:
            yield frame(signal, "measured", "measured", trajectories.newest[:, outputs[signal], 0])
    if first and not is_closed:
        held_values = trajectories.newest[:, :, 0]
        with np.errstate(invalid="ignore"):
            new = (np.diff(held_values, axis=0, prepend=np.nan) != 0) & np.isfinite(held_values)
        yield frame("", "measured", "arrival", np.ones(len(t)))[np.any(new, axis=1)]
    for i, (signal, _) in enumerate(entry_of(scenario).errors):
        for label, name in names.items():
            yield frame(signal, label, "error", trajectories.errors[name][:, i, 0])
            for kind, values in _spread(trajectories.errors[name][:, i]).items():
                yield frame(signal, label, kind, values)
    for label, name in names.items():
        if name in trajectories.nees:
            for kind, values in _mean_nees(*trajectories.nees[name]).items():
                yield frame("", label, kind, values)


def _rows_before_divergence(plan: Plan, trajectories: Trajectories) -> int:
    """Return the number of rows of the first run of a closed loop up to the first one with an error that has diverged."""
    bound = np.asarray(plan.problem.bound)
    estimates = next(iter(trajectories.estimates.values()))[:, :, 0]
    n = min(estimates.shape[1], len(bound))
    has_diverged = ~np.all(np.abs(trajectories.x[:, :n, 0] - estimates[:, :n]) <= bound[:n], axis=1)
    return int(np.argmax(has_diverged)) + 1 if has_diverged.any() else len(has_diverged)


def _spread(errors: jax.Array) -> dict[str, Floats]:
    """Return the band of 90 % of the errors [K, L], their rms and the quantiles of |e|; nothing for one run."""
    if errors.shape[1] < 2:
        return {}
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        quantile = np.nanquantile if np.isnan(errors).any() else np.quantile  # which takes a tenth of the time
        low, high = quantile(errors, [0.05, 0.95], axis=1)
        sizes = dict(zip(SIZES, quantile(np.abs(errors), [*SIZES.values()], axis=1), strict=True))
        return {"low": low, "high": high, "rms": np.sqrt(np.nanmean(errors**2, axis=1))} | sizes


def _mean_nees(squares: jax.Array, states: jax.Array) -> dict[str, Floats]:
    """Return the mean of normalised squares [K, L], of so many states [K, L], over runs, and its band if P is true."""
    finite = np.isfinite(squares)
    degrees = np.where(finite, states, 0).sum(1)
    bands = {d: consistency.band(d) if d else consistency.Band(np.nan, np.nan) for d in {*degrees}}
    with np.errstate(invalid="ignore"):
        mean = np.where(finite, squares * states, 0).sum(1) / np.where(degrees > 0, degrees, np.nan)
    ends = {f"nees_{end}": np.array([getattr(bands[d], end) for d in degrees]) for end in ("low", "high")}
    return {"nees": mean} | ends
