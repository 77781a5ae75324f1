"""The page's first table: winners and their significance, one row per scenario and signal."""

from collections import Counter
from typing import NamedTuple

import numpy as np
import pandas as pd

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.labels import quantity, times
from pcbench.plots.layout import with_powers
from pcbench.plots.palette import styles
from pcbench.report.captions import number
from pcbench.statistics import number_format
from pcbench.statistics.ranking import by_cell, diverges_more, most_often
from pcbench.study import title_of_scenario

MOST = 7  # largest number of ratios in a row
MORE = "diverges more often"  # instead of a ratio, as in tables
LOOP = "steady_tracking_rmse"  # of a closed loop: shows whether it settles, which errors of estimates do not
MIN_P = 1e-3  # a p-value below it is written as "p < 0.001"


class Row(NamedTuple):
    """One scenario and signal."""

    scenario: str
    title: str
    signal: str
    best: list[tuple[str, str]]  # name, colour; empty: all diverge
    is_leader: bool  # no other observer is significantly better
    significance: str  # in words
    value: str  # its metric with interval
    loop: str  # its error of tracking with interval; empty: there is no loop with a set point, or that is its metric
    ratios: list[tuple[str, str, str]]  # name, colour, how many times larger; of at most MOST observers
    n_more: int  # observers whose ratio is not shown
    score: float  # rows are in order of it, the largest first


class Tally(NamedTuple):
    """The wins of one observer."""

    observer: str
    colour: str
    wins: int  # grid points
    leads: int  # grid points at which no other observer is significantly better
    total: int  # grid points at which it ran


class Ranking(NamedTuple):
    """The standings of observers for one signal of a scenario."""

    scenario: str
    signal: str
    part: pd.DataFrame  # `frames.rows`
    standings: pd.DataFrame  # `frames.standings`


def rankings(result: Result, metric: str, signals: list[str] | None) -> list[Ranking]:
    """Return the ranking for each signal that is shown of each scenario; raise UserError if none has the metric."""
    out = [
        Ranking(name, s, frames.rows(result, name, s, metric), frames.standings(result, name, s, metric))
        for name in result.scenarios
        for s in frames.signals_with_metric(result, name, signals, metric)
    ]
    if not out:
        raise UserError(
            f"--metric: got {metric}, which no signal shown has, expected another; see pcbench list metrics."
        )
    return out


def rows(result: Result, rankings: list[Ranking]) -> list[Row]:
    """Return a row for each scenario and signal; scenarios in order of their scores, or in that of the study."""
    all_rows = [_row(result, ranking) for ranking in rankings]
    if keeps_order(result):
        return all_rows
    score: dict[str, float] = {}
    for row in all_rows:
        score[row.scenario] = max(score.get(row.scenario, -np.inf), row.score)
    return sorted(all_rows, key=lambda row: -score[row.scenario])


def keeps_order(result: Result) -> bool:
    """Return whether scenarios are shown in the study's order: those that it defines itself are often variants of one."""
    return set(result.scenarios) <= set(result.study.tables or {})


def tally(rankings: list[Ranking]) -> list[Tally]:
    """Return the number of grid points that each observer wins and leads, over all signals that are shown, the most first."""
    wins, leads, totals = Counter[str](), Counter[str](), Counter[str]()
    for _, _, part, standings in rankings:
        totals.update(dict.fromkeys(part.observer, len(standings)))
        wins.update(standings.winner[standings.winner != ""])
        leads.update(observer for group in standings.leaders for observer in group)
    look = styles(totals)
    tallies = [Tally(o, look[o].colour, wins[o], leads[o], totals[o]) for o in totals]
    return sorted(tallies, key=lambda t: (-t.wins, -t.leads))


def _row(result: Result, ranking: Ranking) -> Row:
    scenario, signal, part, standings = ranking
    look, has_several = styles(part.observer), len(standings) > 1
    wins = standings.winner[standings.winner != ""].value_counts()
    multiples = _multiples(part, standings)
    best = str(standings.best.iloc[0])
    if has_several:  # of equally many cells the least error decides
        best = next((o for o, *_ in multiples if wins.get(o, 0) == wins.max()), "") if len(wins) else ""
    deterministic = not frames.has_spread(part) and not result.exact
    lead = np.nanmedian(standings.factor) if standings.factor.notna().any() else np.nan
    leaders = [best] if has_several and best else most_often(standings.leaders)[0]
    unit, best_rows = part.unit.iloc[0], part[part.observer.isin([best] if best else leaders)]
    loop = result.stats_of(scenario, signal)
    loop = loop[(loop.metric == LOOP) & loop.observer.isin(best_rows.observer)]
    others = [(o, look[o].colour, words) for o, _, words in multiples if multiples[1:] and (has_several or o != best)]
    significance = "one observer"
    if multiples[1:]:
        significance = _significance(standings, wins, best, deterministic, frames.count_runs(part))
    return Row(
        scenario=scenario,
        title=title_of_scenario(result.study, scenario),
        signal=signal.replace("_", " "),
        best=[(o, look[o].colour) for o in leaders or filter(None, [best])],
        is_leader=bool(leaders),
        significance=significance,
        value=_value(best_rows, unit),
        loop="" if part.metric.iloc[0] == LOOP or loop.empty else _value(loop, unit),
        ratios=others[:MOST],
        n_more=max(len(others) - MOST, 0),
        score=(0 if deterministic else 100) + (50 if len(wins) else 0) + (min(np.log(lead), 40.0) if lead > 0 else 0.0),
    )


def _value(rows: pd.DataFrame, unit: str) -> str:
    """Return the mean of one grid point with its interval, or the range of the means of several."""
    if rows.cell.nunique() == 1:
        return quantity(with_powers(number_format.interval(rows.iloc[0])), unit)
    if len(rows) and np.isfinite(rows["mean"].min()):
        return quantity(f"{number(rows['mean'].min())} to {number(rows['mean'].max())}", unit)
    return "-"


def _significance(standings: pd.DataFrame, wins: pd.Series, best: str, deterministic: bool, runs: int) -> str:
    if len(standings) > 1:
        if not best:  # then no cell has a winner
            names, most = most_often(standings.leaders)
            if most:
                return number_format.as_good(names, most, len(standings))
            if not any(standings.best):
                return str(standings.text.iloc[0])
            return "one run: no significance" if runs == 1 else "not compared"
        ties = int((standings.winner == "").sum())
        share = f"{int(wins.get(best, 0))} of {len(standings)} grid points"
        rest = ", ".join(f"{o} {n}" for o, n in wins.items() if o != best)
        return "; ".join(filter(None, [share, rest, f"ties {ties}" if ties else ""]))
    row = standings.iloc[0]
    if not best:
        return str(row.text)
    if runs == 1:
        return "one run: no significance"
    if deterministic and row.winner:
        return "runs do not vary"
    if not runs and row.winner:
        return "the values are exact"
    if row.winner:
        return "significant" + (
            f", p < {MIN_P:g}" if row.p < MIN_P else f", p = {row.p:.2g}" if np.isfinite(row.p) else ""
        )
    return number_format.as_good(row.leaders) if row.leaders else f"not compared with {', '.join(row.alike)}"


def _multiples(part: pd.DataFrame, standings: pd.DataFrame) -> list[tuple[str, float, str]]:
    """Return each observer with its mean divided by that of the cell's best, as number and in words, the least first.

    The number is the median over cells. It is infinite in a cell in which the observer diverges significantly more often than
    the best.
    """
    wide = part.pivot(index="cell", columns="observer", values="mean")
    least, out = standings.set_index("cell")["mean"].reindex(wide.index).fillna(wide.min(axis=1)), []
    cells, best = by_cell(part), dict(zip(standings.cell, standings.best, strict=True))
    more = set[tuple[str, int]]()
    for cell, rows in cells.items():
        first = next((row for row in rows if row["observer"] == best[cell]), None)
        more |= {(row["observer"], cell) for row in rows if first and diverges_more(first, row)}
    for observer in dict.fromkeys(part.observer):
        diverges = np.array([(observer, cell) in more for cell in wide.index])
        mean = wide[observer].fillna(np.inf).mask(diverges, np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(least > 0, mean / least, np.where(mean > 0, np.inf, 1.0))
        median = float(np.median(ratio[least.notna()])) if least.notna().any() else np.inf
        out.append((observer, median, MORE if np.isinf(median) and diverges.any() else times(median)))
    return sorted(out, key=lambda entry: entry[1])
