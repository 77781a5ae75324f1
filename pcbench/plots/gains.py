"""What gains are worth: as printed, by design and tuned; and what a design trades for what."""

import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError, unknown
from pcbench.plots import layout
from pcbench.plots.labels import title_of
from pcbench.plots.layout import PAPER, Key, Panel, Paper, drawn_on, sheet
from pcbench.plots.palette import COLOURS, SOFT, Style, styles

MARKS = {"published": "o", "design": "s", "tuned": "D"}
WORDS = {"published": "as printed", "design": "by design", "tuned": "tuned"}


def fair(result: Result, *, cell: int = 0, paper: Paper = PAPER) -> Figure:
    """Return the objective of every observer with each of its gains: filled on held-out runs, open on training runs.

    Raises UserError where the result has no table `fair`.
    """
    if result.fair is None:
        raise UserError(
            f"study {result.study.name}: got no table fair, expected a study with several tunings; run equal-tuning."
        )
    table = with_ends(result.fair[result.fair.cell == cell])
    names = list(dict.fromkeys(table.observer))
    look, first = styles(names), table.iloc[0]
    shown = table[["held_out", "low", "high", "training"]].to_numpy()
    keys = [Key(WORDS[str(t)], Style(SOFT, (), MARKS[str(t)]), "points", 0.0) for t in dict.fromkeys(table.tuning)]
    keys.append(Key("open: on training runs", Style("#FFFFFF", (), ""), "points", 0.0))
    title = title_of(first.metric, first.signal, first.unit)
    panel = Panel(layout.at(names), layout.of(shown, log=layout.is_wide(shown)), "observer", title)
    figure, (ax,) = sheet(paper, f"{first.scenario}, held-out runs", [panel], keys)
    with drawn_on(paper):
        for tuning, mine in table.groupby("tuning", sort=False):
            x = [names.index(o) + 0.22 * (list(MARKS).index(str(tuning)) - 1) for o in mine.observer]
            colours = [look[o].colour for o in mine.observer]
            mark = MARKS[str(tuning)]
            ax.vlines(x, mine.low, mine.high, colors=colours, linewidth=1.3)
            ax.scatter(
                x, mine.training, facecolors="none", edgecolors=colours, marker=mark, s=62, linewidths=0.8, zorder=2
            )
            ax.scatter(x, mine.held_out, c=colours, marker=mark, s=20, zorder=3, label=WORDS[str(tuning)])
    return figure


def trade_off(
    table: pd.DataFrame, cost: str, *, x: str = "rate", title: str = "", label: str = "", paper: Paper = PAPER
) -> Figure:
    """Return what a promise costs: a column `cost` of a frame of `pcbench.trade_off` over another, the decay rate [1/s].

    `label` is what the cost is called, with its unit.
    """
    for name in (cost, x):
        if name not in table:
            raise unknown("trade-off", "column", name, table.columns)
    stands = table[table.refused == ""]
    words = "promised decay rate [1/s]" if x == "rate" else x.replace("_", " ")
    option = str(table.columns[0])
    over = {name: layout.of(stands[name], layout.is_wide(stands[name]), margin=0.12) for name in (x, cost)}
    panel = Panel(over[x], over[cost], f"{words}; beside a point: {option}", label or cost.replace("_", " "))
    figure, (ax,) = sheet(paper, title, [panel])
    with drawn_on(paper):
        ax.plot(stands[x], stands[cost], marker="o", markersize=4, linewidth=1.2, color=COLOURS["kf"])
        middle = (over[x].low * over[x].high) ** 0.5 if over[x].log else (over[x].low + over[x].high) / 2
        for row in stands.to_dict("records"):
            right = row[x] > middle
            ax.annotate(layout.word(row[option]), (row[x], row[cost]), textcoords="offset points",
                        xytext=(-5 if right else 5, 3), ha="right" if right else "left", fontsize=paper.size - 1)  # fmt: skip
    return figure


def with_ends(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table `fair` with the ends `low` and `high` of the 95 % intervals of what is held out."""
    half = 1.96 * table.held_out_se
    return table.assign(low=table.held_out - half, high=table.held_out + half)
