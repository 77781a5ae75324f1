"""What gains are worth: as printed, by design and tuned; and what a design trades for what."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError, unknown
from pcbench.plots import frames
from pcbench.plots.palette import styles
from pcbench.plots.sheet import dress, legend, sheet, title_of

MARKS = {"paper": "o", "design": "s", "tuned": "D"}


def fair(result: Result, *, cell: int = 0) -> Figure:
    """Return the objective of every observer with each of its gains: filled on held-out runs, open on training runs.

    Raises UserError where the result has no table `fair`.
    """
    if result.fair is None:
        raise UserError(
            f"study {result.study.name}: got no table fair, expected a study with several tunings; run fair."
        )
    table = frames.with_ends(result.fair[result.fair.cell == cell])
    names = list(dict.fromkeys(table.observer))
    look, first = styles(names), table.iloc[0]
    figure, ((ax,),) = sheet()
    for tuning, mine in table.groupby("tuning", sort=False):
        x = np.array([names.index(o) for o in mine.observer]) + 0.22 * (list(MARKS).index(str(tuning)) - 1)
        colours = [look[o].colour for o in mine.observer]
        ax.vlines(x, mine.low, mine.high, colors=colours)
        ax.scatter(x, mine.held_out, c=colours, marker=MARKS[str(tuning)], s=36, zorder=3)
        ax.scatter(x, mine.training, facecolors="none", edgecolors=colours, marker=MARKS[str(tuning)], s=80, zorder=2)
        ax.scatter([], [], c="#555555", marker=MARKS[str(tuning)], label=str(tuning))
    ax.scatter([], [], facecolors="none", edgecolors="#555555", marker="o", s=80, label="on training runs")
    ax.set_xticks(range(len(names)), names)
    ax.set_yscale("log")
    dress(ax, "", title_of(first.metric, first.signal, first.unit), first.scenario)
    legend(figure, ax)
    return figure


def trade_off(table: pd.DataFrame, cost: str, *, x: str = "rate", title: str = "") -> Figure:
    """Return what a promise costs: a column `cost` of a frame of `pcbench.trade_off` over another, the decay rate [1/s]."""
    for name in (cost, x):
        if name not in table:
            raise unknown("trade-off", "column", name, table.columns)
    stands = table[table.refused == ""]
    figure, ((ax,),) = sheet()
    ax.plot(stands[x], stands[cost], marker="o", color="#0072B2")
    for row in stands.to_dict("records"):
        ax.annotate(
            f"{row[table.columns[0]]}", (row[x], row[cost]), textcoords="offset points", xytext=(6, -10), fontsize=8
        )
    dress(ax, "promised decay rate [1/s]" if x == "rate" else x, cost, title)
    return figure
