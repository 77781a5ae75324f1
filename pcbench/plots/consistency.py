"""Whether observers know how wrong they are, over time."""

import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames, one_run, scales
from pcbench.plots.canvas import PAPER, Paper, drawn_on
from pcbench.plots.labels import title_of_scenario
from pcbench.plots.layout import Key, Panel, sheet
from pcbench.plots.lines import keys_of, line
from pcbench.plots.palette import GRID, SOFT, Style

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
    whole = one_run.of(result.study, scenario, result.out, cell, seed)
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
    x, y = scales.linear(0.0, float(part.t.max())), scales.of(positive, scales.is_wide(positive))
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
