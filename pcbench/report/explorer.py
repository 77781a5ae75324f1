"""The numbers of the interactive figure of a report: `explorer.js` draws them, from JSON in the page.

They are means and intervals of the table `stats`, and comparisons with the best observer of a grid point from `pairs`. The
ratio of two means a / b has Student's interval of its logarithm. It is that of `statistics.comparison.paired_ratio`, without
the runs: over the same n runs, with standard errors sa and sb of the means a and b, and sd of their difference,

    se(log (a / b))^2 = sa^2 / a^2 + sb^2 / b^2 - (sa^2 + sb^2 - sd^2) / (a b).

If a run of one of the two diverged, the ratio has no interval. Numbers have five digits, and missing ones are null.
"""

import json
from collections.abc import Iterable
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd
from markupsafe import Markup
from numpy.typing import NDArray

from pcbench.dataset.columns import MEANING
from pcbench.dataset.result import Result
from pcbench.errors import printable
from pcbench.plots import frames, layout
from pcbench.plots.labels import describe_metric
from pcbench.plots.palette import Style, styles
from pcbench.statistics import COMPARED, OF_RUN, POOLED, Row, ranking
from pcbench.statistics.consistency import BANDS, INSIDE
from pcbench.statistics.distributions import student_quantile
from pcbench.statistics.number_format import ROUNDING
from pcbench.study import title_of_scenario

DIGITS = 5
PAIR = ("observer_a", "observer_b", "n", "se", "p_holm", "prob_a_better", "mean_diff")
HIDDEN = ("mse", "steady_mse", "nees_dof", "nis_dof", *BANDS.values())  # squares of others, and no results of their own
EXPECTED = {
    "rms_efficiency": 1.0,
    "interval_coverage": 1.0,
    **dict.fromkeys(BANDS, 1.0),
    **dict(zip(INSIDE, (0.683, 0.954, 0.997), strict=True)),  # of Gaussian errors
}
WORDS = {
    "nees": "NEES: squared error divided by the covariance",
    "nis": "NIS: squared innovation divided by its covariance",
    "signal_nees": "squared error of {} divided by its variance",
    "interval_width": "mean width of the interval of {}",
    "interval_coverage": "fraction of ticks at which {} is in its interval",
    "sent_fraction": "fraction of samples sent",
    "rms_efficiency": "Kalman bound divided by the rms error of {}",
    "divergence_rate": "fraction of runs that diverged",
    "unsettled_rate": "fraction of runs in which {} is not settled",
    **{name: f"fraction of errors of {{}} within {k} sigma" for k, name in enumerate(INSIDE, 1)},
}
OF_STATS = {  # metrics that a table of runs does not have
    "pooled_rmse": "square root of the expected square of e over ticks 0 .. N-1",
    "steady_pooled_rmse": "square root of the expected square of e from the scenario's steady_start on",
    "pooled_tracking_rmse": "square root of the expected square of the set point minus the state, in a closed loop",
    "steady_pooled_tracking_rmse": "pooled_tracking_rmse from steady_start on",
    "rms_efficiency": "the least steady_pooled_rmse of any causal estimator divided by that of the observer; 1 is best",
    "divergence_rate": "the fraction of runs whose error became non-finite or exceeded the scenario's divergence threshold; "
    "no mean includes them",
}
Numbers = NDArray[np.float64]
Table = dict[str, Any]


class Grid(NamedTuple):
    """The observers and the grid points of a scenario: the order of all its numbers, observer by observer."""

    observers: list[str]
    cells: list[int]


class Rows(NamedTuple):
    """The rows of stats of one signal and metric."""

    columns: dict[str, NDArray[Any]]
    place: tuple[NDArray[np.intp], NDArray[np.intp]]  # of each row: its observer, its grid point
    shape: tuple[int, int]

    def values(self, column: str) -> Numbers:
        """Return a column as an array [observers, cells]; NaN where there is no row."""
        out = np.full(self.shape, np.nan)
        out[self.place] = self.columns[column]
        return out

    @property
    def exact(self) -> bool:
        """Whether some numbers are exact."""
        return bool((self.columns["method"] == "exact").any())


def numbers(result: Result, metric: str) -> Markup:
    """Return the numbers of a result as JSON for a page, with the metric that is shown first."""
    names = list(dict.fromkeys(result.stats.observer))
    metrics = [m for m in dict.fromkeys(result.stats.metric) if m not in HIDDEN]
    table = {
        "metric": metric,
        "alone": result.study.vary == "one-at-a-time",
        "observers": [_look(name, style) for name, style in styles(names).items()],
        "metrics": {name: _metric(name) for name in metrics},
        "scenarios": [_scenario(result, name, names) for name in result.scenarios],
    }
    text = json.dumps(table, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _look(name: str, style: Style) -> Table:
    return {"name": printable(name), "colour": style.colour, "dash": style.dash, "marker": style.marker}


def _metric(name: str) -> Table:
    is_ranked = POOLED.get(name, name) in COMPARED
    title = WORDS.get(name) or describe_metric(name, "{}").removesuffix(" of {}" if name in OF_RUN else "")
    group = "errors and times" if is_ranked else "consistency of filters" if name in (*BANDS, *INSIDE) else "other"
    means = (MEANING | OF_STATS).get(name, "")
    return {"title": title, "means": means, "about": group, "ranked": is_ranked, "expected": EXPECTED.get(name)}


def _scenario(result: Result, scenario: str, names: list[str]) -> Table:
    first = frames.signals_by_default(result, scenario)  # the figure shows the first at first
    signals = [*first, *(s for s in result.signals(scenario) if s not in first)]
    stats = pd.concat([result.stats_of(scenario, signal) for signal in signals])
    grid = Grid(list(dict.fromkeys(stats.observer)), sorted(set(stats.cell)))
    points = stats.drop_duplicates("cell").sort_values("cell").reset_index(drop=True)
    points = frames.simplify_axes(result, points)
    titles = frames.axis_titles(result, points)
    axes, places = [], []
    for name in frames.varying_axes(points):
        words = [frames.word(name, v) for v in points[name]]
        values = list(dict.fromkeys(words))
        places.append([values.index(word) for word in words])
        axes.append(_axis(name, values, points[name], titles))
    diverged = _rows(stats.drop_duplicates(["observer", "cell"]), grid).values("diverged")
    return {
        "title": printable(title_of_scenario(result.study, scenario)),
        "observers": [names.index(name) for name in grid.observers],
        "axes": axes,
        "cells": list(zip(*places, strict=True)) if places else [()],
        "lost": _rounded(diverged) if (diverged > 0).any() else None,
        "signals": [_signal(result, scenario, signal, grid) for signal in signals],
    }


def _rows(stats: pd.DataFrame, grid: Grid) -> Rows:
    i, j = (
        pd.Index(names).get_indexer(pd.Index(stats[column]))
        for names, column in ((grid.observers, "observer"), (grid.cells, "cell"))
    )
    columns = ("mean", "se", "ci_low", "ci_high", "n", "diverged", "method", "unit")
    return Rows({name: stats[name].to_numpy() for name in columns}, (i, j), (len(grid.observers), len(grid.cells)))


def _axis(name: str, words: list[str], column: pd.Series, titles: dict[str, frames.AxisTitle]) -> Table:
    values = list(dict.fromkeys(column)) if len(words) == column.nunique(dropna=False) else words
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) and np.isfinite(v) for v in values)
    return {
        "name": name,
        "label": printable(frames.label(name, titles)),
        "words": list(map(printable, words)),
        "values": values if numeric else None,
        "log": bool(numeric and layout.is_wide(values)),
    }


def _signal(result: Result, scenario: str, signal: str, grid: Grid) -> Table:
    stats, pairs = result.stats_of(scenario, signal), result.pairs_of(scenario, signal)
    by_metric = {str(name): _rows(rows, grid) for name, rows in stats.groupby("metric", sort=False)}
    comparisons: dict[str, dict[int, list[Row]]] = {}
    for row in cast(list[Row], pairs[["metric", "cell", *PAIR]].to_dict("records")):
        comparisons.setdefault(row["metric"], {}).setdefault(row["cell"], []).append(row)
    series = {}
    for name, rows in by_metric.items():
        if name in HIDDEN or np.isnan(rows.columns["mean"].astype(float)).all():
            continue
        series[name] = _series(rows)
        if POOLED.get(name, name) in COMPARED and (rows.exact or name not in POOLED) and len(grid.observers) > 1:
            series[name] |= _comparison(rows, comparisons.get(name, {}), grid)
        if band := by_metric.get(BANDS.get(name, "")):
            series[name] |= {"band_low": _rounded(band.values("ci_low")), "band_high": _rounded(band.values("ci_high"))}
    unit = str(by_metric["mae"].columns["unit"][0]) if "mae" in by_metric else str(stats.unit.iloc[0])
    return {"name": printable(signal.replace("_", " ")), "unit": printable(unit), "series": series}


def _series(rows: Rows) -> Table:
    mean, low, high, runs = (rows.values(column) for column in ("mean", "ci_low", "ci_high", "n"))
    out = {"unit": printable(str(rows.columns["unit"][0])), "mean": _rounded(_round_to_zero(mean))}
    if (high > low).any():
        out |= {"low": _rounded(low), "high": _rounded(high)}
    same = len(np.unique(runs[np.isfinite(runs)])) == 1
    return out | {"n": int(np.nanmax(runs)) if same else _rounded(runs)}


def _round_to_zero(mean: Numbers) -> Numbers:
    return np.where(np.abs(mean) < ROUNDING, 0.0, mean)


def _comparison(rows: Rows, comparisons: dict[int, list[Row]], grid: Grid) -> Table:
    """Return the best observer of each grid point, and each other's verdict, p-value and interval of its ratio to the best.

    A verdict is 0: not significantly worse, 1: worse, 2: diverges significantly more often, or 3: not compared.
    """
    best, (verdict, p, diff_se) = np.full(len(grid.cells), -1), np.full((3, *rows.shape), np.nan)
    mean, n, diverged = _round_to_zero(rows.values("mean")), rows.values("n"), rows.values("diverged")
    for j, cell in enumerate(grid.cells):
        present = [i for i in range(len(grid.observers)) if np.isfinite(n[i, j])]
        by_observer = {
            grid.observers[i]: {
                "observer": grid.observers[i],
                "mean": mean[i, j],
                "n": n[i, j],
                "diverged": diverged[i, j],
            }
            for i in present
        }
        pairs = comparisons.get(cell, [])
        standing = ranking.standing_of(list(by_observer.values()), pairs)
        first = standing.order[0]
        if not np.isfinite(by_observer[first]["mean"]):
            continue
        best[j] = grid.observers.index(first)
        for i in present:
            name = grid.observers[i]
            diverges = ranking.diverges_more(by_observer[first], by_observer[name])
            equal = name in (first, *standing.alike)
            verdict[i, j] = 2 if diverges else 1 if not equal else 0 if standing.leaders else 3
        for row in pairs:
            if first in (row["observer_a"], row["observer_b"]):
                i = grid.observers.index(row["observer_b" if row["observer_a"] == first else "observer_a"])
                p[i, j], diff_se[i, j] = row["p_holm"], row["se"]
    half = _half_width(rows, best, diff_se)
    out = {"best": best.tolist(), "verdict": _rounded(verdict), "p": _rounded(p, 2)}
    return out | ({"half": _rounded(half, 4)} if np.isfinite(half).any() else {})


def _half_width(rows: Rows, best: NDArray[np.int64], diff_se: Numbers) -> Numbers:
    """Return half the interval of the logarithm of each observer's ratio to the best, [observers, cells]; NaN: none."""
    mean, se, n, high, diverged = (rows.values(name) for name in ("mean", "se", "n", "ci_high", "diverged"))
    mean_b, se_b, n_b, high_b, diverged_b = (v[best, np.arange(len(best))] for v in (mean, se, n, high, diverged))
    with np.errstate(divide="ignore", invalid="ignore"):
        if rows.exact:  # the ratio of two exact numbers has no interval, and those of others are independent
            half = np.hypot(*(np.nan_to_num(np.log(h / m)) for h, m in ((high, mean), (high_b, mean_b))))
            return np.where((best >= 0) & (half > 0) & np.isfinite(mean), half, np.nan)
        covariance = (se**2 + se_b**2 - diff_se**2) / 2
        variance = (se / mean) ** 2 + (se_b / mean_b) ** 2 - 2 * covariance / (mean * mean_b)
        common = (best >= 0) & (n == n_b) & (diverged == 0) & (diverged_b == 0) & (n > 1) & (mean > 0) & (mean_b > 0)
        t = [[student_quantile(int(runs) - 1, 0.975) if runs > 1 else np.nan for runs in row] for row in n]
        return np.where(common, np.array(t) * np.sqrt(np.maximum(variance, 0.0)), np.nan)


def _rounded(values: Numbers | Iterable[float], digits: int = DIGITS) -> list[float | int | None]:
    """Return numbers, observer by observer, with few digits; None for one that is not finite."""
    flat = np.asarray(values, float).ravel()
    short = (float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in flat)
    return [int(v) if v is not None and v == int(v) and abs(v) < 1e9 else v for v in short]
