"""Regret matrix: the error of each observer in each situation, divided by the least error of that situation.

A situation is a scenario at a grid point. Those whose least error is 0 are left out.
"""

from math import ceil, inf, isfinite
from typing import NamedTuple, cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames, layout
from pcbench.plots.labels import describe_metric, title_of_scenario
from pcbench.plots.layout import PAPER, Paper, sheet
from pcbench.plots.palette import GRID, SOFT, on
from pcbench.statistics.aggregate import Row
from pcbench.statistics.number_format import ROUNDING

COLUMNS = 16  # situations side by side
MOST = 48  # situations; of more there is no matrix
ROW, CELL = 0.21, 0.36  # inches
DARKEST = 10.0  # at least the ratio with the darkest colour
HATCH = "#C4C4C499"  # of cells that are not significant
KEYS = (1.0, 2.0, 5.0, 10.0, 100.0)
COLOURS = LinearSegmentedColormap.from_list("regrets", ["#FFFFFF", "#A9C1DA", "#5A88B8", "#1B4674"])


class Regrets(NamedTuple):
    """The regrets of observers in situations."""

    # situation, scenario, signal, cell, observer, ratio (inf: diverged), best, worse (significantly)
    rows: pd.DataFrame
    observers: list[str]  # in order of their largest ratio
    situations: list[str]
    runs: int  # 0: exact
    signals: list[str]

    @property
    def largest(self) -> dict[str, float]:
        """Return the largest ratio of each observer."""
        return {o: float(self.rows.ratio[self.rows.observer == o].max()) for o in self.observers}


def regrets_of(
    result: Result, metric: str = frames.METRIC, signals: list[str] | None = None, most: int | None = MOST
) -> Regrets | None:
    """Return the regrets over all scenarios and grid points; None if they are fewer than two, or more than `most`.

    Of each scenario, the first main signal is taken, or the first of `signals` that it has.
    """
    metric = result.ranks(metric)
    parts, chosen, runs = list[pd.DataFrame](), dict[str, None](), 0
    for scenario in result.scenarios:
        for signal in frames.signals_with_metric(result, scenario, signals, metric)[:1]:
            part, stood = (f(result, scenario, signal, metric) for f in (frames.rows, frames.standings))
            equal = zip(stood.cell, stood.leaders, stood.alike, strict=True)
            leaders = {cell: {*leading, *alike} for cell, leading, alike in equal}
            best = dict(zip(stood.cell, stood.best, strict=True))
            least = part.cell.map(part[["cell", "mean"]].groupby("cell")["mean"].min())
            names = {cell: _situation(result, part, cell) for cell in best}
            rows = pd.DataFrame({"situation": part.cell.map(names), "observer": part.observer.astype(str)})
            rows = rows.assign(scenario=scenario, signal=signal, cell=part.cell)
            rows["ratio"] = np.where(np.isfinite(part["mean"]), part["mean"] / least.where(least > ROUNDING), inf)
            rows["best"] = [o == best[c] for o, c in zip(part.observer, part.cell, strict=True)]
            rows["worse"] = [
                o not in leaders[c] and o != best[c] for o, c in zip(part.observer, part.cell, strict=True)
            ]
            parts.append(rows[(least > ROUNDING).to_numpy()])
            chosen[signal] = None
            runs = max(runs, int((part.n + part.diverged).max()))
    whole = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({"situation": [], "observer": []})
    situations, observers = (list(dict.fromkeys(whole[name])) for name in ("situation", "observer"))
    if len(observers) < 2 or not 2 <= len(situations) <= (most or len(situations)):
        return None
    found = Regrets(whole, observers, situations, runs, list(chosen))
    largest = found.largest
    return found._replace(observers=sorted(observers, key=lambda o: largest[o]))


def _situation(result: Result, part: pd.DataFrame, cell: int) -> str:
    """Return the name of a scenario at a grid point: what differs from others of the study."""
    words = [frames.format_axis(axis, value) for axis, value in frames.named_values(result, part, cell).items()]
    several = len(result.scenarios) > 1
    return ", ".join([title_of_scenario(result, part.scenario.iloc[0])] * (several or not words) + words)


def regrets(
    result: Result,
    *,
    metric: str = frames.METRIC,
    signals: list[str] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return a matrix of observers and situations: the error divided by the least error of the situation.

    A situation is a scenario at a grid point; `signals` selects their signals (None: the first main signal of each). Rows are
    in order of their largest ratio. Hatched: not significantly worse than the best (paired t-test, Holm, 5 %). Raises
    UserError for an unknown name, and if the study has fewer than two situations or observers.
    """
    found = regrets_of(result, metric, signals, None)
    if found is None:
        raise UserError(
            f"plots.regrets: got fewer than two observers or situations with an error above 0 in {result.study.name}, "
            "expected two; give the study an axis with several values or several scenarios."
        )
    finite = found.rows.ratio[np.isfinite(found.rows.ratio)]
    darkest = max(DARKEST, float(finite.max()))
    norm = LogNorm(1.0, darkest)
    panels = ceil(len(found.situations) / COLUMNS)
    columns = ceil(len(found.situations) / panels)
    words = max(paper.width_of(name, 1) for name in found.situations)
    names = max(paper.width_of(name, 1) for name in found.observers)
    upright = words > CELL - 0.05
    runs = f"{found.runs:,} runs, hatched: not significant (paired t-test, Holm, 5 %)" if found.runs > 1 else "exact"
    runs = "one run" if found.runs == 1 else runs
    subject = describe_metric(result.ranks(metric), " or ".join(found.signals))
    keys = [Patch(facecolor=COLOURS(norm(v)), edgecolor=SOFT, linewidth=0.4, label=f"{layout.number(v)}")
            for v in KEYS if v <= darkest]  # fmt: skip
    keys.append(Patch(facecolor="white", edgecolor=SOFT, hatch="/////", linewidth=0.0, label="not significant"))
    with sheet(
        paper,
        f"{subject} / least of the column [-], {result.study.name}, {runs}",
        panels,
        height=ROW * len(found.observers) + (words if upright else 0.0),
        width=max(paper.width, min(paper.full, names + CELL * columns + 0.3)),
        keys=keys,
    ) as (figure, axes):
        for i, ax in enumerate(axes):
            _draw_panel(ax, found, found.situations[i * columns : (i + 1) * columns], norm, upright, paper)
    return figure


def _draw_panel(ax: Axes, found: Regrets, situations: list[str], norm: LogNorm, upright: bool, paper: Paper) -> None:
    ax.set(xlim=(-0.5, len(situations) - 0.5), ylim=(len(found.observers) - 0.5, -0.5))
    ax.set_yticks(range(len(found.observers)), found.observers)
    ax.set_xticks(range(len(situations)), situations, rotation=90 if upright else 0)
    ax.grid(False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    for row in cast(list[Row], found.rows[found.rows.situation.isin(situations)].to_dict("records")):
        x, y = situations.index(row["situation"]), found.observers.index(row["observer"])
        colour = to_hex(COLOURS(norm(row["ratio"]) if isfinite(row["ratio"]) else 1.0))
        ties = not (row["best"] or row["worse"])
        patch = Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor=colour, edgecolor=GRID, linewidth=0.6)
        text = number(row["ratio"])
        patch.set_gid(f"tip:{row['observer']}, {row['situation']}: {text}{', not significant' if ties else ''}")
        ax.add_patch(patch)
        if ties:
            ax.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, edgecolor=HATCH, hatch="/////", linewidth=0.0))
        ax.text(x, y, text, ha="center", va="center", fontsize=paper.size - 2, color=on(colour), in_layout=False,
                fontweight="bold" if row["best"] else "normal")  # fmt: skip


def number(ratio: float) -> str:
    """Return a ratio in at most four letters."""
    if not isfinite(ratio):
        return "∞"
    if ratio < 1.095:
        return f"{ratio:.2f}" if ratio >= 1.005 else "1"
    return f"{ratio:.2g}" if ratio < 99.5 else layout.number(float(f"{ratio:.2g}"))
