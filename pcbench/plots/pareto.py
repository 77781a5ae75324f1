"""What an observer is worth against what it costs."""

import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import unknown
from pcbench.plots import frames, scales
from pcbench.plots.canvas import PAPER, Paper, drawn_on
from pcbench.plots.labels import about, title_of
from pcbench.plots.layout import Key, Panel, sheet
from pcbench.plots.palette import styles

WORDS = {
    "sample": "multiplications of a sample",
    "tick": "multiplications of a tick",
    "memory": "bytes of memory",
}


def cost(
    result: Result,
    costs: pd.DataFrame,
    *,
    by: str = "sample",
    metric: str = "steady_rmse",
    scenario: str | None = None,
    signal: str | None = None,
    cell: int = 0,
    paper: Paper = PAPER,
) -> Figure:
    """Return a metric of every observer of a cell over what it costs (`pcbench.operation_counts`), by sample, tick or memory.

    Raises UserError where there is no such cost.
    """
    if by not in WORDS:
        raise unknown("cost", "cost", by, WORDS)
    whole = frames.rows(result, scenario, signal, metric)
    chosen = whole[whole.cell == cell]
    both = chosen.merge(costs[["scenario", "cell", "observer", *WORDS]], on=["scenario", "cell", "observer"])
    both = both[both[by] > 0]  # what costs nothing has no place on a scale of factors
    look, row = styles(both.observer), chosen.iloc[0]
    x = scales.of(both[by], scales.is_wide(both[by]), margin=0.12)
    y = scales.of(both[["mean", "ci_low", "ci_high"]], scales.is_wide(both["mean"]), margin=0.12)
    panel = Panel(x, y, WORDS[by], title_of(metric, row.signal, row.unit))
    keys = [Key(o, look[o], "points", 0.0) for o in both.observer]
    figure, (ax,) = sheet(paper, about(result, chosen, frames.values_at(whole, cell)), [panel], keys)
    with drawn_on(paper):
        for one in both.to_dict("records"):
            style = look[one["observer"]]
            ax.vlines(one[by], one["ci_low"], one["ci_high"], colors=style.colour, linewidth=1.2)
            ax.scatter([one[by]], [one["mean"]], c=style.colour, marker=style.marker, s=26, zorder=3)
    return figure
