"""Runs of one cell in time, thinned for the eye: one of them, and how far the errors of several reach.

The run shown is the study's first seed, or any other; beside it run the seeds after it, so that the picture can say what of an
error is luck. They are simulated anew by the functions that made the tables, and kept in the folder `examples` beside these,
where they are found again: one file for each scenario, of the cell and seed that were looked at last.
"""

from pathlib import Path

import pandas as pd

from pcbench.errors import UserError
from pcbench.plots import example_cache, example_runs
from pcbench.plots.example_runs import POINTS, RUNS
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import Study
from pcbench.study.grid import Cell, cells

FORM = 3  # of the file


def of(
    study: Study, scenario: str, out: str | Path | None, cell: int = 0, seed: int | None = None
) -> pd.DataFrame | None:
    """Return one run of a scenario as `several` does."""
    return several(study, {scenario: cell}, out, seed)[scenario]


def several(
    study: Study, at: dict[str, int], out: str | Path | None, seed: int | None = None, progress: Progress = SILENT
) -> dict[str, pd.DataFrame | None]:
    """Return signal, series, kind, t [s], value of one run of each scenario, in the cell that `at` says of it.

    What does not stand in the folder `out` is made, all together, and put there.

    `kind` is truth (of the plant; in a closed loop each observer has its own), estimate, error (truth less estimate), low and
    high (between which nine in ten errors of RUNS runs lie at that time) and rms (over them), measured (as it has arrived and
    is held; of signals that an output shows as they are) or target (of a closed loop). Where the study asks for consistency,
    also sigma (the standard deviation that an observer believes, of this run) and, of no signal, nees, nees_low and nees_high
    (the mean over these runs of e' P^-1 e / n, and where it lies in 95 of 100 cases if P is true). Runs that are all alike,
    and those with schedules of their own, have no low, high and rms. None where it does not stand there and the code of an
    observer of a user's own is not here. Raises UserError for a cell that the scenario has not.
    """
    chosen = {scenario: _cell(study, scenario, number) for scenario, number in at.items()}
    seed = study.first_seed if seed is None else seed
    if not 0 <= seed < 2**32 - RUNS:
        raise UserError(f"--seed: got {seed}, expected a seed index of 0 or more, below 2^32 - {RUNS}.")
    about = [seed, POINTS, RUNS, FORM]
    things = {scenario: example_cache.Thing(scenario, cell, about) for scenario, cell in chosen.items()}
    found = {scenario: example_cache.found(out, thing) for scenario, thing in things.items()}
    missing = {name: t.cell for name, t in things.items() if found[name] is None and t.can_be_made}
    for scenario, made in example_runs.several(missing, study.root_seed, seed, progress).items():
        found[scenario] = example_cache.keep(out, things[scenario], made)
    return found


def _cell(study: Study, scenario: str, number: int) -> Cell:
    every = {each.number: each for each in cells(study, scenario)}
    if number not in every:
        raise UserError(
            f"--grid-point: got {number}, expected one of 0 .. {len(every) - 1}, the cells of {scenario}; take one."
        )
    return every[number]
