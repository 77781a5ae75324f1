"""The report's first table of a scenario: who is better, by how much, and how surely."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pcbench.dataset.result import Result
from pcbench.plots import frames, layout
from pcbench.plots.palette import styles
from pcbench.statistics import number_format
from pcbench.statistics.ranking import diverges_more

MOST = 4  # cells that stand in full; of more, wins are counted
COSTS = {"sample": "products a sample", "tick": "products a tick", "memory": "bytes"}
BESIDE = ("rmse", "steady_rmse", "rms_efficiency")  # what stands beside the metric that ranks


class Headline(NamedTuple):
    """A table of words, a row for each observer."""

    title: str
    heads: list[str]
    rows: list[dict[str, Any]]  # cells in the order of heads, colour, best: no other is surely better, note
    note: str


def headlines(
    result: Result, scenario: str, signal: str, metric: str, cell: int = 0, costs: pd.DataFrame | None = None
) -> list[Headline]:
    """Return a table for each cell, or of many cells one that counts who wins how many, and that of one `cell`.

    `costs` are what its observers cost, a frame of `pcbench.operation_counts` of this cell alone.
    """
    part = frames.rows(result, scenario, signal, metric)
    cells = list(dict.fromkeys(part.cell))
    if len(cells) > MOST:
        counted = _counted(result, scenario, signal, metric, part)
        return [counted, _cell(result, scenario, signal, metric, part, cell, costs)]
    return [_cell(result, scenario, signal, metric, part, e, costs if e == cell else None) for e in cells]


def _cell(
    result: Result,
    scenario: str,
    signal: str,
    metric: str,
    part: pd.DataFrame,
    cell: int,
    costs: pd.DataFrame | None = None,
) -> Headline:
    stats, pairs = result.stats_of(scenario, signal), result.pairs_of(scenario, signal)
    mine, look = stats[stats.cell == cell], styles(part.observer)
    met = pairs[(pairs.metric == metric) & (pairs.cell == cell)]
    wide = mine.set_index(["observer", "metric"])
    ranked = part[part.cell == cell].sort_values(["diverged", "mean"], kind="stable", na_position="last")
    order, ranked = list(ranked.observer), ranked.set_index("observer")
    beside = [m for m in BESIDE if m != metric]
    found = frames.standings(result, scenario, signal, metric)
    leaders = next(iter(found.leaders[found.cell == cell]))
    rows: list[dict[str, Any]] = []
    for observer in order:
        row = wide.loc[observer]
        against = "" if observer == order[0] else number_format.difference(met, observer, order[0])
        if observer != order[0] and diverges_more(ranked.loc[order[0]], ranked.loc[observer]):
            against = "diverges more often"
        lost = row.loc["divergence_rate"]
        name = number_format.marked(observer, [row.loc[metric].certified])
        cells = [name, number_format.interval(row.loc[metric]), "not surely different" if against == "=" else against]
        cells += [number_format.interval(row.loc[m]) if m in row.index else "-" for m in beside]
        cells += ["-" if np.isnan(lost["mean"]) else "none" if lost["mean"] == 0 else number_format.fraction(lost)]
        cells += _costs(costs, observer)
        rows.append({"cells": cells, "colour": look[observer].colour, "best": observer in leaders})
    here = part[part.cell == cell].iloc[0]
    at = ", ".join(frames.said(a, here[a]) for a in frames.varying(part))
    here_unit = mine[mine.metric == "rmse"].unit.iloc[0]
    unit, n = here.unit, int((part.n + part.diverged).max())
    heads = ["observer", f"{metric} [{unit}]", f"less the best [{unit}]"]
    heads += [m if m == "rms_efficiency" else f"{m} [{here_unit}]" for m in beside] + ["diverged", *COSTS.values()]
    title = f"At {at}" if at else ""
    kept = [i for i in range(len(heads)) if any(row["cells"][i] not in ("none", "-") for row in rows)]
    rows = [row | {"cells": [row["cells"][i] for i in kept]} for row in rows]
    lost = " Means are over the runs that did not diverge." if heads.index("diverged") in kept else " No run diverged."
    runs = (
        f"{n:,} runs each; ± is half a 95 % interval." if n > 1 else "One run each: no interval, and nothing is sure."
    )
    if not n:
        runs, lost = "Exact: the expected values over all noise.", ""
    return Headline(title, [heads[i] for i in kept], rows, f"{runs}{lost} {result.unproven(scenario)}".strip())


def _costs(costs: pd.DataFrame | None, observer: str) -> list[str]:
    """What an observer costs, in the order of COSTS."""
    if costs is None or observer not in set(costs.observer):
        return ["-" for _ in COSTS]
    mine = costs.set_index("observer").loc[observer]
    return [f"{mine[name]:,}" for name in COSTS]


def _counted(result: Result, scenario: str, signal: str, metric: str, part: pd.DataFrame) -> Headline:
    won, look = frames.standings(result, scenario, signal, metric), styles(part.observer)
    wins = won[won.winner != ""].winner.value_counts()
    rows: list[dict[str, Any]] = []
    for observer, mine in part.groupby("observer", sort=False):
        share = 100 * mine.diverged.sum() / max((mine.n + mine.diverged).sum(), 1)
        median = layout.number(float(f"{np.nanmedian(mine['mean']):.4g}")) if mine["mean"].notna().any() else "-"
        name = number_format.marked(str(observer), mine.certified)
        led = sum(observer in each for each in won.leaders)
        cells = [name, str(wins.get(observer, 0)), str(led), median, "none" if not share else f"{share:.3g} %"]
        rank = {"wins": int(wins.get(observer, 0)), "median": float(mine["mean"].median())}
        rows.append({"cells": cells, "colour": look[str(observer)].colour, "best": False} | rank)
    rows.sort(key=lambda row: (-row["wins"], row["median"]))
    heads = ["observer", "cells won", "as good as the best", f"median {metric} [{part.unit.iloc[0]}]", "diverged"]
    ties = int((won.winner == "").sum())
    note = (
        f"An observer wins a cell if it is significantly better than every other (paired t-test, Holm, 5 %); {ties} of "
        f"{len(won)} cells have no winner. It is as good as the best if none is significantly better."
    )
    title = f"Over all {len(won)} cells"
    return Headline(title, heads, rows, f"{note} {result.unproven(scenario)}".strip())
