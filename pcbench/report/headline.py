"""The report's first table of a scenario: ranked observers with differences and significance."""

import re
from typing import NamedTuple

import numpy as np
import pandas as pd

from pcbench.dataset.result import Result
from pcbench.plots import frames, layout
from pcbench.plots.labels import with_unit
from pcbench.plots.lines import COSTS
from pcbench.plots.palette import styles
from pcbench.report.captions import describe_grid_point
from pcbench.report.summary import Ranking, tally
from pcbench.statistics import number_format
from pcbench.statistics.ranking import diverges_more

TIE = "="
MARKS = {
    "±": "± is half a 95 % interval",
    "..": "(a .. b) is a 95 % interval",
    TIE: "= is not significant (paired t-test, Holm, 5 %)",
}
MOST = 4  # grid points that have their own table; of more, wins are counted

OTHER_METRICS = ("rmse", "steady_rmse", "rms_efficiency", "steady_tracking_rmse")  # columns after the metric that ranks


class HeadlineRow(NamedTuple):
    """The row of one observer."""

    cells: list[str]  # texts, in the order of the heads
    colour: str
    is_leader: bool  # no other observer is significantly better


class Headline(NamedTuple):
    """A table of texts with one row per observer."""

    title: str
    heads: list[str]
    rows: list[HeadlineRow]
    note: str


def headlines(
    result: Result, scenario: str, signal: str, metric: str, cell: int = 0, costs: pd.DataFrame | None = None
) -> list[Headline]:
    """Return a table per grid point; of many, a table of the wins and that of one `cell`. The last is of the operations.

    `costs` is a frame of `pcbench.operation_counts` of this grid point; None: there is no table of operations.
    """
    part = frames.rows(result, scenario, signal, metric)
    standings = frames.standings(result, scenario, signal, metric)
    cells = list(dict.fromkeys(part.cell))
    win_tables = [_count_wins(result, Ranking(scenario, signal, part, standings), metric)] if len(cells) > MOST else []
    leaders = dict(zip(standings.cell, standings.leaders, strict=True))
    table_cells = [cell] if win_tables else cells
    tables = [_cell(result, scenario, signal, part, metric, number, leaders[number]) for number in table_cells]
    return win_tables + tables + ([] if costs is None else [_operations(part, costs)])


def _operations(part: pd.DataFrame, costs: pd.DataFrame) -> Headline:
    """Return the table of the operations of one run."""
    look = styles(part.observer)
    rows = [
        HeadlineRow(
            [str(row["observer"]), *(f"{row[name]:,}" for name in COSTS)], look[str(row["observer"])].colour, False
        )
        for row in costs[costs.observer.isin(look)].to_dict("records")
    ]
    note = "Multiplications of the observers' functions in one run, and the bytes they store from tick to tick."
    return Headline("Operations", ["observer", *COSTS.values()], rows, note)


def _cell(
    result: Result, scenario: str, signal: str, part: pd.DataFrame, metric: str, cell: int, leaders: tuple[str, ...]
) -> Headline:
    stats, pairs = result.stats_of(scenario, signal), result.pairs_of(scenario, signal)
    stats, look = stats[stats.cell == cell], styles(part.observer)
    pairs, wide = pairs[(pairs.metric == metric) & (pairs.cell == cell)], stats.set_index(["observer", "metric"])
    ranking = part[part.cell == cell].sort_values(["diverged", "mean"], kind="stable", na_position="last")
    ranking = ranking.set_index("observer")
    other_metrics = [m for m in OTHER_METRICS if m != metric]
    rows, better = [], []
    for i, observer in enumerate(ranking.index):
        row = wide.loc[observer]
        difference = number_format.difference(pairs, observer, ranking.index[0]) if i else ""
        if i and diverges_more(ranking.iloc[0], ranking.iloc[i]):
            difference = "diverges more often"
        if re.match(r"\(?-\d", difference):
            better.append(str(observer))
        rate = row.loc["divergence_rate"]
        cells = [
            number_format.mark_uncertified(observer, [row.loc[metric].certified]),
            number_format.interval(row.loc[metric]),
        ]
        cells.append(difference)
        cells += [number_format.interval(row.loc[m]) if m in row.index else "-" for m in other_metrics]
        cells.append("-" if np.isnan(rate["mean"]) else number_format.fraction(rate) if rate["mean"] else "none")
        rows.append(HeadlineRow(cells, look[observer].colour, observer in leaders))
    first = part[part.cell == cell].iloc[0]
    at = describe_grid_point(result, part, cell)
    unit, n = stats[stats.metric == "rmse"].unit.iloc[0], frames.count_runs(part)
    heads = ["observer", *(with_unit(head, first.unit) for head in (metric, "diff. to best"))]
    heads += [m if m == "rms_efficiency" else with_unit(m, unit) for m in other_metrics] + ["diverged"]
    columns = [i for i in range(len(heads)) if any(row.cells[i] not in ("none", "-", "") for row in rows)]
    rows = [row._replace(cells=[row.cells[i] for i in columns]) for row in rows]
    texts = " ".join(text for row in rows for text in row.cells[1:])
    legend = [words for mark, words in MARKS.items() if mark in texts and (mark != TIE or frames.has_spread(part))]
    note = (
        "; ".join([f"{n:,} runs each", *legend]) + "."
        if n > 1
        else "One run each: no intervals, and no significant differences."
        if len(rows) > 1
        else "One run each: no intervals."
    )
    some_diverge = heads.index("diverged") in columns
    note += " Means are over the runs that did not diverge." if some_diverge else " None of them diverged."
    if better:
        note += (
            f" {ranking.index[0]} is first because fewer of its runs diverged, though not significantly fewer. The error of "
            f"{', '.join(better)} is significantly less, so there is no winner."
        )
    note = note if n else "Exact expected values over all noise."
    title = f"At {at}" if at else ""
    return Headline(title, [heads[i] for i in columns], rows, f"{note} {result.unproven(scenario)}".strip())


def _count_wins(result: Result, s: Ranking, metric: str) -> Headline:
    _, _, part, standings = s
    keyed_rows = []
    tallies = {t.observer: t for t in tally([s])}
    for observer, group in ((str(o), group) for o, group in part.groupby("observer", sort=False)):
        t, share = tallies[observer], 100 * group.diverged.sum() / max((group.n + group.diverged).sum(), 1)
        median = float(group["mean"].median())
        cells = [number_format.mark_uncertified(observer, group.certified), str(t.wins), str(t.leads)]
        cells.append("-" if np.isnan(median) else layout.number(float(f"{median:.4g}")))
        cells.append(f"{share:.3g} %" if share else "none")
        keyed_rows.append(((-t.wins, median), HeadlineRow(cells, t.colour, is_leader=False)))
    rows = [row for _, row in sorted(keyed_rows, key=lambda pair: pair[0])]
    heads = [
        "observer",
        "grid points won",
        "as good as the best",
        with_unit(f"median {metric}", part.unit.iloc[0]),
        "diverged",
    ]
    if len(rows) == 1:  # it is compared with none
        rows = [row._replace(cells=[row.cells[0], *row.cells[3:]]) for row in rows]
        title = f"All {len(standings)} grid points"
        return Headline(title, [heads[0], *heads[3:]], rows, result.unproven(s.scenario).strip())
    ties = int((standings.winner == "").sum())
    runs = frames.count_runs(part) > 0
    better, test = ("significantly better", " (paired t-test, Holm, 5 %)") if runs else ("better", "")
    note = (
        f"An observer wins a grid point if it is {better} than every other{test}. {ties} of {len(standings)} grid points have "
        f"no winner. An observer is as good as the best if none is {better}."
    )
    return Headline(f"All {len(standings)} grid points", heads, rows, f"{note} {result.unproven(s.scenario)}".strip())
