"""Published, designed and tuned gains compared, and the trade-off of a design."""

import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError, unknown
from pcbench.plots import frames, layout
from pcbench.plots.labels import title_of
from pcbench.plots.layout import PAPER, Paper, set_range, set_values, sheet
from pcbench.plots.palette import LOOKS, SOFT, styles

TUNINGS = {  # text, marker, and horizontal offset from its observer
    "published": ("published", "o", -0.22),
    "design": ("designed", "s", 0.0),
    "tuned": ("tuned", "D", 0.22),
}


def fair(result: Result, *, cell: int = 0, paper: Paper = PAPER) -> Figure:
    """Return each observer's objective with published, designed and tuned gains.

    Filled marks are held-out runs with 95 % intervals. Open marks are training runs, or the expected value if gains were tuned
    on it. Raises UserError if the result has no table `fair`.
    """
    if result.fair is None:
        raise UserError(
            f"study {result.study.name}: got no table fair, expected a study with several tunings; run equal-tuning."
        )
    table = result.fair[result.fair.cell == cell]
    half = 1.96 * table.held_out_se  # of the 95 % interval
    table = table.assign(low=table.held_out - half, high=table.held_out + half)
    look, first = styles(result.stats.observer), table.iloc[0]  # of the labels, as in the other figures
    runs = frames.count_runs(result.stats)
    with sheet(paper, f"{first.scenario}, {f'{runs:,} ' if runs else ''}held-out runs") as (figure, (ax,)):
        place = set_values(ax, "x", list(dict.fromkeys(table.observer)))
        set_range(ax, "y", table[["held_out", "low", "high", "training"]].to_numpy())
        ax.set(title=title_of(first.metric, first.signal, first.unit), xlabel="observer")
        for tuning, group in table.groupby("tuning", sort=False):
            word, mark, offset = TUNINGS[str(tuning)]
            x = [place(o) + offset for o in group.observer]
            colours = [look[label].colour for label in group.label]
            ax.vlines(x, group.low, group.high, colors=colours, linewidth=1.3)
            ax.scatter(
                x, group.training, facecolors="none", edgecolors=colours, marker=mark, s=62, linewidths=0.8, zorder=2
            )
            ax.scatter(x, group.held_out, c=colours, marker=mark, s=20, zorder=3)
            ax.scatter([], [], c=SOFT, marker=mark, s=20, label=word)
        tuned_on = "training runs" if table.training_se.any() else "expected value"
        ax.scatter([], [], facecolors="none", edgecolors=SOFT, marker="o", s=62, linewidths=0.8, label=tuned_on)
    return figure


def trade_off(
    table: pd.DataFrame, cost: str, *, x: str = "rate", title: str = "", label: str = "", paper: Paper = PAPER
) -> Figure:
    """Return a column `cost` of a frame of `pcbench.trade_off` over another column, by default the decay rate [1/s].

    `label` is the name of the cost, with its unit.
    """
    for name in (cost, x):
        if name not in table:
            raise unknown("trade-off", "column", name, table.columns)
    designs = table[table.refused == ""]
    words = "guaranteed decay rate [1/s]" if x == "rate" else x.replace("_", " ")
    option = str(table.columns[0])
    with sheet(paper, title) as (figure, (ax,)):
        set_range(ax, "x", designs[x], margin=0.12)
        set_range(ax, "y", designs[cost], margin=0.12)
        ax.set(title=label or cost.replace("_", " "), xlabel=f"{words}; label of a point: {option}")
        ax.plot(designs[x], designs[cost], marker="o", markersize=4, linewidth=1.2, color=LOOKS["kf"].colour)
        for row in designs.to_dict("records"):
            right = ax.transLimits.transform(ax.transScale.transform((row[x], row[cost])))[0] > 0.5
            ax.annotate(layout.word(row[option]), (row[x], row[cost]), textcoords="offset points",
                        xytext=(-5 if right else 5, 3), ha="right" if right else "left", fontsize=paper.size - 1)  # fmt: skip
    return figure
