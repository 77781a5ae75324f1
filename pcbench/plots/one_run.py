"""Runs of one cell in time, thinned for the eye: one of them, and how far the errors of several reach.

The run shown is the study's first seed, or any other; beside it run the seeds after it, so that the picture can say what of an
error is luck. They are simulated anew by the functions that made the tables, and kept in the folder `examples` beside these,
where they are found again: one file for each scenario, of the cell and seed that were looked at last.

Whether observers know how wrong they are, over time.

Delays of a recorded log: over time, and how often each occurs.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import example_runs, frames, layout, observer_costs
from pcbench.plots.example_runs import POINTS, RUNS
from pcbench.plots.labels import title_of_scenario
from pcbench.plots.layout import PAPER, Key, Panel, Paper, drawn_on, sheet
from pcbench.plots.lines import keys_of, line
from pcbench.plots.palette import GRID, SOFT, Style
from pcbench.recordings.survey import Survey
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
    things = {scenario: observer_costs.Thing(scenario, cell, about) for scenario, cell in chosen.items()}
    found = {scenario: observer_costs.found(out, thing) for scenario, thing in things.items()}
    missing = {name: t.cell for name, t in things.items() if found[name] is None and t.can_be_made}
    for scenario, made in example_runs.several(missing, study.root_seed, seed, progress).items():
        found[scenario] = observer_costs.keep(out, things[scenario], made)
    return found


def _cell(study: Study, scenario: str, number: int) -> Cell:
    every = {each.number: each for each in cells(study, scenario)}
    if number not in every:
        raise UserError(
            f"--grid-point: got {number}, expected one of 0 .. {len(every) - 1}, the cells of {scenario}; take one."
        )
    return every[number]


TITLE = "squared error over what is believed (NEES / n)"
BAND = Key("95 % if right", Style(GRID, (), ""), "patch")


def nees(
    result: Result, *, scenario: str | None = None, cell: int = 0, seed: int | None = None, paper: Paper = PAPER
) -> Figure:
    """Return the mean of e' P^-1 e / n over runs at every time, for each observer that believes a covariance P of its error e.

    Shaded is where the mean lies in 95 of 100 cases if P is true (chi-square). The runs are those of `time`. Raises UserError
    where the study does not ask for consistency, or no observer of it has a covariance.
    """
    scenario = frames.scenario_of(result, scenario)
    whole = of(result.study, scenario, result.out, cell, seed)
    if whole is None or not judged(whole):
        raise UserError(
            f"plots.nees: got runs of {scenario} in which nobody says how wrong it is, expected consistency = true in "
            "[options.scenario] and an observer with a covariance, as kf; run the study so."
        )
    return drawn(result, whole, scenario, cell, paper)


def judged(whole: pd.DataFrame) -> bool:
    """Say whether a run in time, a frame of `one_run.of`, has what this picture shows."""
    return bool((whole.kind == "nees").any())


def drawn(result: Result, whole: pd.DataFrame, scenario: str, cell: int, paper: Paper) -> Figure:
    """Draw a run that is at hand, a frame of `one_run.of`."""
    named, part = frames.rows(result, scenario, None, "mae"), whole[whole.kind.str.startswith("nees")]
    keys = [key for key in keys_of(dict.fromkeys(named.observer)) if key.label in set(part.series)]
    positive = part.value[part.value > 0]
    x, y = layout.linear(0.0, float(part.t.max())), layout.of(positive, layout.is_wide(positive))
    at = (frames.said(a, v) for a, v in frames.values_at(named, cell).items())
    title, panel = ", ".join([title_of_scenario(result, scenario), *at]), Panel(x, y, "t [s]", TITLE)
    figure, (ax,) = sheet(paper, title, [panel], [*keys, BAND])
    with drawn_on(paper):
        ends = part[part.kind != "nees"].groupby(["kind", "t"]).value
        low, high = ends.min()["nees_low"], ends.max()["nees_high"]
        ax.fill_between(low.index, low, high, color=GRID, linewidth=0, zorder=1)
        ax.axhline(1.0, color=SOFT, linewidth=0.6, zorder=1.2)
        for key in keys:
            mine = part[(part.series == key.label) & (part.kind == "nees")]
            ax.plot(mine.t, mine.value.where(mine.value > 0), label=key.label, **line(key))
    return figure


BINS = 40
DIGITS = 9  # of a second: what is less is rounding


def delays(table: pd.DataFrame, *, paper: Paper = PAPER) -> Figure:
    """Return the delays of every channel of a log over time, and their histogram; `table` is what `pcbench.info` returns.

    Of a long log an even selection of samples is drawn. Raises UserError where no sample ever arrived.
    """
    found: Survey = table.attrs["survey"]
    kept = {name: seen.delays.kept.round(DIGITS) for name, seen in found.channels.items() if len(seen.delays.kept)}
    if not kept:
        raise UserError(
            f"plots.delays: got a log {table.attrs['name']} in which nothing arrived, expected samples that did."
        )
    late = np.concatenate([each[:, 1] for each in kept.values()])
    keys, edges = keys_of(kept), edges_of(late)
    y = layout.of([late.min(), late.max(), edges[0], edges[-1]])
    shares = {name: np.histogram(each[:, 1], edges)[0] / len(each) for name, each in kept.items()}
    x = layout.linear(0.0, max(found.end - found.start, 1e-9))
    panels = [
        Panel(x, y, "time since the start [s]", "delay [s]"),
        Panel(y, layout.of([0.0, *np.concatenate(list(shares.values()))]), "delay [s]", "share of samples"),
    ]
    figure, (over_time, often) = sheet(paper, "", panels, keys if len(keys) > 1 else [])
    with drawn_on(paper):
        for key in keys:
            t, delay = kept[key.label].T
            over_time.scatter(t - found.start, delay, s=2, color=key.style.colour, linewidths=0, rasterized=True)
            often.stairs(shares[key.label], edges, color=key.style.colour, linewidth=1.2)
    return figure


def edges_of(late: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges of some BINS bars, each as wide as a whole number of the delays' smallest difference.

    Of delays in whole ticks every bar so holds as many ticks as any other: none is empty for its width alone.
    """
    values = np.unique(late)
    step = float(np.diff(values).min()) if len(values) > 1 else max(float(values[0]) / BINS, 1e-3)
    width = step * max(np.ceil((values[-1] - values[0]) / step / BINS), 1)
    first = values[0] - step / 2
    many = int(np.floor((values[-1] - first) / width)) + 1
    edges: NDArray[np.float64] = first + width * np.arange(many + 1)
    return edges
