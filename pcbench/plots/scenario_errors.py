"""Dot plot of a metric in each scenario, for studies whose scenarios differ in one number, such as a period."""

import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.labels import describe_metric, describe_runs, unit_of, with_unit
from pcbench.plots.layout import PAPER, Paper, set_range, sheet
from pcbench.plots.palette import styles
from pcbench.study import title_of_scenario

ROW, OFFSET = 0.2, 0.5  # inches of a row; part of a row that the observers of a scenario take


def rows_of(result: Result, signal: str | None = None, metric: str = frames.METRIC, cell: int = 0) -> pd.DataFrame:
    """Return the rows of stats of the scenarios that have the signal, the metric and the grid point."""
    first = frames.rows(result, None, signal, metric)
    signal, metric = str(first.signal.iloc[0]), str(first.metric.iloc[0])
    others = [
        frames.rows(result, scenario, signal, metric)
        for scenario in result.scenarios[1:]
        if signal in frames.signals_with_metric(result, scenario, [], metric)
    ]
    parts = [first, *others]
    return pd.concat([part[part.cell == cell] for part in parts], ignore_index=True)


def scenarios(
    result: Result, *, signal: str | None = None, metric: str = frames.METRIC, cell: int = 0, paper: Paper = PAPER
) -> Figure:
    """Return a dot plot: the metric of each observer in each scenario, with 95 % intervals.

    `cell` is the number of the grid point. Raises UserError for an unknown name, and if fewer than two scenarios have the
    signal and the metric.
    """
    table = rows_of(result, signal, metric, cell)
    names = list(dict.fromkeys(table.scenario))
    if len(names) < 2:
        raise UserError(
            f"plots.scenarios: expected two scenarios or more with this signal, metric and grid point, got {len(names)}; "
            "use plots.ratios or plots.curves."
        )
    first = frames.rows(result, names[0], str(table.signal.iloc[0]), metric)
    words = describe_metric(str(table.metric.iloc[0]), str(table.signal.iloc[0]))
    intervals = ["95 % intervals"] * bool((table.ci_high > table.ci_low).any())
    at = frames.describe_values(result, first, cell)
    title = ", ".join([words, *at, describe_runs(frames.count_runs(table)), *intervals])
    look = styles(table.observer)
    with sheet(paper, title, height=ROW * len(names) + 0.1) as (figure, (ax,)):
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_yticks(range(len(names)), [title_of_scenario(result.study, name) for name in names])
        ax.tick_params(axis="y", length=0)
        ax.grid(False, axis="y")
        ax.set_xlabel(with_unit(words, unit_of(table)))
        for i, (observer, style) in enumerate(look.items()):
            part = table[table.observer == observer]
            shift = OFFSET * ((i + 0.5) / len(look) - 0.5)
            places = part.scenario.map(names.index).to_numpy(float) + shift
            ax.hlines(places, part.ci_low, part.ci_high, color=style.colour, linewidth=1.5)
            ax.plot(
                part["mean"], places, style.marker, color=style.colour, markersize=5, linestyle="none", label=observer
            )
        set_range(ax, "x", table[["mean", "ci_low", "ci_high"]].to_numpy(float).ravel())
    return figure
