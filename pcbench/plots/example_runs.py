"""Runs in time, made: the programs that the scenarios of a study need, compiled and called side by side."""

import warnings
from collections.abc import Hashable
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pcbench.engine import runner
from pcbench.planning import alone, drafts, padding
from pcbench.planning.padding import Plan
from pcbench.plants import signals_of
from pcbench.plots import output_units
from pcbench.runtime import config, thread_pools
from pcbench.runtime.progress import SILENT, Progress
from pcbench.simulation import trajectory
from pcbench.statistics import consistency
from pcbench.study.grid import Cell

POINTS = 240  # ticks that are kept, or up to twice as many
RUNS = 32  # beside one another, where runs differ: nine in ten of their errors lie in the band


class Asked(NamedTuple):
    """A plan that is to be recorded: all observers of an open loop, one of a closed loop."""

    scenario: str
    plan: Plan  # of one run, as wide as there are seeds
    every: int  # ticks from row to row
    rows: int
    root_seed: int
    seeds: NDArray[np.int64]  # [RUNS], or [1] where all runs are alike


def several(at: dict[str, Cell], root_seed: int, seed: int, progress: Progress = SILENT) -> dict[str, pd.DataFrame]:
    """Return the runs of a cell of each scenario, from `seed` on, as `one_run.several` has them."""
    if not at:
        return {}
    with config.float64():
        asked = [_asked(plan, root_seed, seed) for plan in padding.fit(list(drafts(list(at.values()))))]
    progress.begin("runs in time", len(asked))
    groups: dict[Hashable, list[int]] = {}  # by program, which is then made once
    for i, each in enumerate(asked):
        groups.setdefault(_shapes(each), []).append(i)
    made: dict[int, trajectory.Thinned] = {}
    with thread_pools.pool(runner.cores()) as threads:
        work = [threads.submit(runner.in_float64, _recorded, [asked[i] for i in group]) for group in groups.values()]
        for group, done in zip(groups.values(), work, strict=True):
            made |= zip(group, done.result(), strict=True)
            progress.step(len(group))
    parts: dict[str, list[pd.DataFrame]] = {scenario: [] for scenario in at}
    for i, each in enumerate(asked):
        parts[each.scenario] += _series(each, made[i], first=not parts[each.scenario])
    return {scenario: pd.concat(frames, ignore_index=True) for scenario, frames in parts.items()}


def _asked(plan: Plan, root_seed: int, seed: int) -> Asked:
    """What is to be recorded of a plan."""
    many, ticks, plan = RUNS if _differ(plan) else 1, plan.cell.times.ticks, alone(plan, root_seed, seed)
    every = -(-(ticks + 1) // (2 * POINTS)) if ticks >= POINTS else 1
    plan = plan._replace(layout=plan.layout._replace(width=many))
    return Asked(plan.cell.key[0], plan, every, ticks // every + 1, root_seed, np.arange(seed, seed + many))


def _shapes(each: Asked) -> Hashable:
    return padding.key_of(each.plan), each.every, each.rows


def _recorded(group: list[Asked]) -> list[trajectory.Thinned]:
    """The runs of plans of one shape."""
    layout, every, rows = group[0].plan.layout, group[0].every, group[0].rows
    given = [(each.plan.problem, np.asarray(each.root_seed), each.seeds) for each in group]
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(np.shape(a), np.asarray(a).dtype), given[0])

    def record(*a: Any) -> trajectory.Thinned:
        return trajectory.record_some(layout, every, rows, *a)

    call = jax.jit(record).lower(*shapes).compile()
    return [jax.tree.map(np.asarray, call(*jax.tree.map(np.asarray, a))) for a in given]


def _series(each: Asked, made: trajectory.Thinned, first: bool) -> list[pd.DataFrame]:
    """The series of one plan; `first` of its scenario."""
    plan, cell = each.plan, each.plan.cell
    t, closed = each.every * np.arange(each.rows) * cell.scenario.dt, bool(cell.scenario.loop.controller)
    labels, shown = list(plan.labels), output_units.shows(cell.scenario)
    out = []
    for i, (signal, _) in enumerate(signals_of(cell.scenario)):
        series: dict[tuple[str, str], Any] = {
            (f"plant under {labels[0]}" if closed else "plant", "truth"): made.x[:, i, 0]
        }
        for label, (called, _) in zip(labels, plan.layout.observers, strict=True):
            found = made.estimates[called]
            if i < found.shape[1]:
                error = made.x[:, i] - found[:, i]
                series |= {(label, "estimate"): found[:, i, 0], (label, "error"): error[:, 0]}
                series |= {(label, kind): values for kind, values in _reach(error).items()}
                if called in made.sigma:
                    series |= {(label, "sigma"): made.sigma[called][:, i, 0]}
        if first and i < made.target.shape[1]:
            series |= {("target", "target"): made.target[:, i]}
        if signal in shown and not closed:
            series |= {("measured", "measured"): made.held[:, shown[signal], 0]}
        out += _frames(signal, t, series)
    for label, (called, _) in zip(labels, plan.layout.observers, strict=True):
        if called in made.nees:
            out += _frames("", t, {(label, kind): values for kind, values in _honesty(*made.nees[called]).items()})
    return out


def _frames(signal: str, t: NDArray[Any], series: dict[tuple[str, str], Any]) -> list[pd.DataFrame]:
    return [
        pd.DataFrame({"signal": signal, "series": name, "kind": kind, "t": t, "value": values})
        for (name, kind), values in series.items()
    ]


def _honesty(squares: Any, states: Any) -> dict[str, NDArray[np.float64]]:
    """The mean of normalised squares [K, L] over runs, and the band of a true belief, of so many states [K, L]."""
    known = np.isfinite(squares)
    many = np.where(known, states, 0).sum(1)
    bands = {degrees: consistency.band(degrees) if degrees else consistency.Band(np.nan, np.nan) for degrees in {*many}}
    with np.errstate(invalid="ignore"):
        mean = np.where(known, squares * states, 0).sum(1) / np.where(many > 0, many, np.nan)
    ends = {f"nees_{end}": np.array([getattr(bands[d], end) for d in many]) for end in ("low", "high")}
    return {"nees": mean} | ends


def _differ(plan: Plan) -> bool:
    """Say whether runs differ and stand on one schedule."""
    p, layout = plan.problem, plan.layout
    noisy = np.any(p.noise_std) and not layout.continuous
    drawn = (
        layout.random_initial_state or layout.scattered or layout.drifting or layout.pending or np.any(p.process_std)
    )
    return bool(noisy or drawn) and not plan.cell.times.random


def _reach(errors: Any) -> dict[str, NDArray[np.float64]]:
    """How far errors [K, L] reach: 5 and 95 % of them, and their root mean square; nothing of one run."""
    if errors.shape[1] < 2:
        return {}
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        quantile = np.nanquantile if np.isnan(errors).any() else np.quantile  # which takes a tenth of the time
        low, high = quantile(errors, [0.05, 0.95], axis=1)
        return {"low": low, "high": high, "rms": np.sqrt(np.nanmean(errors**2, axis=1))}
