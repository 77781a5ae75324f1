"""Runs of one cell in time, thinned for the eye: one of them, and how far the errors of several reach.

The run shown is the study's first seed, or any other; beside it run the seeds after it, so that the picture can say what of an
error is luck. They are simulated anew by the functions that made the tables, and kept in the folder `examples` beside these,
where they are found again: one file for each scenario, of the cell and seed that were looked at last.
"""

import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.machine import process
from pcbench.planning import alone, drafts, padding
from pcbench.planning.padding import Plan
from pcbench.plants import signals_of
from pcbench.plots import outputs
from pcbench.plots.kept import kept
from pcbench.statistics import consistency
from pcbench.study import Study
from pcbench.study.cells import Cell, cells

FORM = 3  # of the file
POINTS = 240  # ticks that are kept, or up to twice as many
RUNS = 32  # beside one another, where runs differ: nine in ten of their errors lie in the band


def of(
    study: Study, scenario: str, out: str | Path | None, cell: int = 0, seed: int | None = None
) -> pd.DataFrame | None:
    """Return signal, series, kind, t [s], value of one run; made where it does not stand in the folder `out`.

    `kind` is truth (of the plant; in a closed loop each observer has its own), estimate, error (truth less estimate), low and
    high (between which nine in ten errors of RUNS runs lie at that time) and rms (over them), measured (as it has arrived and
    is held; of signals that an output shows as they are) or target (of a closed loop). Where the study asks for consistency,
    also sigma (the standard deviation that an observer believes, of this run) and, of no signal, nees, nees_low and nees_high
    (the mean over these runs of e' P^-1 e / n, and where it lies in 95 of 100 cases if P is true). Runs that are all alike,
    and those with schedules of their own, have no low, high and rms. None where it does not stand there and the code of an
    observer of a user's own is not here. Raises UserError for a cell that the scenario has not.
    """
    every = {each.number: each for each in cells(study, scenario)}
    if cell not in every:
        raise UserError(
            f"--cell: got {cell}, expected one of 0 .. {len(every) - 1}, the cells of {scenario}; take one."
        )
    seed = study.first_seed if seed is None else seed
    if not 0 <= seed < 2**32 - RUNS:
        raise UserError(f"--seed: got {seed}, expected a seed index of 0 or more, below 2^32 - {RUNS}.")
    about = [seed, POINTS, RUNS, FORM]
    return kept(out, scenario, every[cell], about, lambda: _made(study, every[cell], seed))


def _made(study: Study, cell: Cell, seed: int) -> pd.DataFrame:
    with process.float64():
        plans = padding.fit(list(drafts([cell])))
        parts = [part for i, plan in enumerate(plans) for part in _series(plan, study.root_seed, seed, first=i == 0)]
    return pd.concat(parts, ignore_index=True)


def _series(plan: Plan, root_seed: int, seed: int, first: bool) -> list[pd.DataFrame]:
    """The series of one plan: all observers of an open loop, one of a closed loop."""
    from pcbench.simulation import trace

    cell, many = plan.cell, RUNS if _differ(plan) else 1
    plan = alone(plan, root_seed, seed)
    every = -(-(cell.times.ticks + 1) // (2 * POINTS)) if cell.times.ticks >= POINTS else 1
    rows = cell.times.ticks // every + 1
    seeds = np.arange(seed, seed + many)
    made = trace.compiled_some()(plan.layout, every, rows, plan.problem, np.asarray(root_seed), seeds)
    made = jax.tree.map(np.asarray, made)
    t, closed = every * np.arange(rows) * cell.scenario.dt, bool(cell.scenario.loop.controller)
    labels, shown = list(plan.labels), outputs.shows(cell.scenario)
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


def _honesty(squares: NDArray[np.float64], states: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
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
    drawn = layout.random_start or layout.scattered or layout.drifting or layout.pending or np.any(p.process_std)
    return bool(noisy or drawn) and not plan.cell.times.random


def _reach(errors: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """How far errors [K, L] reach: 5 and 95 % of them, and their root mean square; nothing of one run."""
    if errors.shape[1] < 2:
        return {}
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        low, high = np.nanquantile(errors, [0.05, 0.95], axis=1)
        return {"low": low, "high": high, "rms": np.sqrt(np.nanmean(errors**2, axis=1))}
