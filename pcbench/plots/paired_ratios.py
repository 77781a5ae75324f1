"""Forest plot of paired ratios: each observer's error divided by that of the best observer on the same runs.

The interval is `statistics.comparison.paired_ratio`, over the runs in which neither of the two diverged. Of exact numbers a
ratio has no interval. If only one of the two is exact, the interval of the other is kept, and two intervals are combined as
independent.
"""

from typing import NamedTuple, cast

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames, layout
from pcbench.plots.labels import about, describe_metric, unit_of, with_unit
from pcbench.plots.layout import NARROW, PAPER, Paper, set_limits, set_range, sheet
from pcbench.plots.palette import GRID, INK, SOFT, Style, styles
from pcbench.statistics import COMPARED, POOLED
from pcbench.statistics.aggregate import Row
from pcbench.statistics.comparison import paired_ratio
from pcbench.statistics.number_format import ROUNDING, mark_uncertified
from pcbench.statistics.ranking import by_cell, diverges_more

BOUNDED = ("steady_rmse", "steady_pooled_rmse")  # metrics with a Kalman bound
BOUND = "Kalman bound"
ROW, THICK = 0.2, 0.34  # inches of a row; half the height of its zone, in rows
LEAST = 1e-3  # p-values below it are not written out
EQUAL = 1e-9  # a ratio that differs less from 1 is rounding


class Ratios(NamedTuple):
    """The ratios of a grid point."""

    rows: pd.DataFrame  # observer, ratio, ci_low, ci_high, n, p, worse (significantly), diverged (share); best first
    best: str
    value: float  # the mean of the best
    bound: pd.Series | None  # the row of stats of the best's rms_efficiency: the Kalman bound divided by its rms error
    exact: bool  # no ratio has an interval

    @property
    def intervals(self) -> bool:
        """Whether a ratio has an interval: not if the numbers are exact or runs do not vary."""
        return bool((self.rows.ci_high > self.rows.ci_low).any())

    @property
    def has_p(self) -> bool:
        """Whether a ratio has a p-value."""
        return bool(np.isfinite(self.rows.p).any())


def ratios_of(
    result: Result, scenario: str | None = None, signal: str | None = None, metric: str = frames.METRIC, cell: int = 0
) -> Ratios | None:
    """Return the ratios of a grid point; None for one observer, for a least mean of 0, or for a metric that ranks nothing."""
    metric = result.ranks(metric)
    stats = frames.rows(result, scenario, signal, metric)
    scenario, signal = str(stats.scenario.iloc[0]), str(stats.signal.iloc[0])
    part, standings = stats[stats.cell == cell], frames.standings(result, scenario, signal, metric)
    standing = standings[standings.cell == cell].iloc[0]
    best = standing.best
    table = part.set_index("observer", drop=False)
    is_ranked = POOLED.get(metric, metric) in COMPARED
    if not is_ranked or len(part) < 2 or not best or not table["mean"][best] > ROUNDING:
        return None
    pairs = result.pairs_of(scenario, signal)
    comparisons = by_cell(pairs[(pairs.metric == metric) & (pairs.cell == cell)]).get(cell, [])
    p = {str(row["observer_b" if row["observer_a"] == best else "observer_a"]): float(row["p_holm"])
         for row in comparisons if best in (row["observer_a"], row["observer_b"])}  # fmt: skip
    exact = bool((part.method == "exact").any())
    means = part.iloc[np.lexsort((part["mean"], part["mean"].isna()))]
    ratio_rows = _of_means(table, best) if exact else ratios_to(result, scenario, signal, metric, cell, best)
    rows = pd.DataFrame({"observer": means.observer.to_list()}).join(ratio_rows, on="observer")
    rows["p"] = rows.observer.map(p)
    rows["worse"] = [o not in standing.leaders and o not in standing.alike and o != best for o in rows.observer]
    runs = table.loc[rows.observer, ["n", "diverged"]].to_numpy(float)
    rows["diverged"] = runs[:, 1] / np.maximum(runs.sum(1), 1)
    rows["more"] = [diverges_more(table.loc[best], table.loc[o]) for o in rows.observer]
    rows["certified"] = table.certified.loc[rows.observer].to_list()
    rows = rows.sort_values("observer", key=lambda names: names != best, kind="stable", ignore_index=True)
    efficiency = result.stats_of(scenario, signal)
    bound = efficiency[
        (efficiency.metric == "rms_efficiency") & (efficiency.cell == cell) & (efficiency.observer == best)
    ]
    has_bound = metric in BOUNDED and len(bound) and np.isfinite(bound["mean"].iloc[0])
    return Ratios(rows, best, float(table["mean"][best]), bound.iloc[0] if has_bound else None, exact)


def ratios_to(result: Result, scenario: str, signal: str, metric: str, cell: int, best: str) -> pd.DataFrame:
    """Return ratio, ci_low, ci_high and n of each observer, relative to one of them, on the same runs."""
    column = POOLED.get(metric, metric)
    runs = result.runs_of(scenario, [column], cell)
    runs = runs[runs.signal == signal]
    wide = runs.assign(value=runs[column].where(~runs.diverged)).pivot(index="seed", columns="observer", values="value")
    out = {}
    for observer in wide.columns:
        values = wide[[observer, best]].to_numpy(float)[:, [0, -1]]
        a, b = values[np.isfinite(values).all(1)].T
        e = paired_ratio(a[None], b[None])
        ends = np.array([e.mean[0], e.ci_low[0], e.ci_high[0]])
        out[str(observer)] = (*(np.sqrt(ends) if metric in POOLED else ends), e.n)
    return pd.DataFrame.from_dict(out, orient="index", columns=["ratio", "ci_low", "ci_high", "n"])


def _of_means(stats: pd.DataFrame, best: str) -> pd.DataFrame:
    """Return the same from rows of stats, some of them exact."""
    mean, high = stats["mean"].to_numpy(float), stats.ci_high.to_numpy(float)
    is_best = stats.observer.to_numpy(str) == best
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.nan_to_num(np.log(high / mean))
    half = np.where(is_best, 0.0, np.hypot(half, half[is_best]))
    ratio = mean / mean[is_best]
    rows = {"ratio": ratio, "ci_low": ratio * np.exp(-half), "ci_high": ratio * np.exp(half), "n": stats.n.to_numpy()}
    return pd.DataFrame(rows, index=stats.index)


def ratios(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    cell: int = 0,
    paper: Paper = PAPER,
) -> Figure:
    """Return a forest plot: the error of each observer divided by that of the best one, with 95 % paired intervals.

    `cell` is the number of the grid point. A ratio inside the gray zone of its row is not distinguishable from 1. Hollow
    markers are not significant (paired t-test, Holm, 5 %), and the p-values are at the right. The Kalman bound, if there is
    one, has a row of its own. Raises UserError for an unknown name, and if there is no ratio: one observer only, or an error
    of 0.
    """
    stats = frames.rows(result, scenario, signal, metric)
    table = ratios_of(result, scenario, signal, metric, cell)
    if table is None:
        raise UserError(
            f"plots.ratios: got one observer or a least error of 0 at grid point {cell} of {stats.scenario.iloc[0]}, expected "
            "two observers and a least error above 0; use another grid point."
        )
    rows, look = table.rows, styles(stats.observer)
    words = describe_metric(result.ranks(metric), stats.signal.iloc[0])
    subject = about(result, stats, frames.named_values(result, stats, cell))
    methods = ["95 % paired intervals"] * table.intervals + ["p-values of the paired t-test (Holm)"] * table.has_p
    title = ", ".join([f"{words}: {subject}", *methods])
    keys: list[Artist] = [Patch(color=GRID, label="not distinguishable (95 %)")] if table.intervals else []
    if not rows.worse[1:].all():
        hollow = Line2D([], [], color=SOFT, marker="o", markerfacecolor="white", linestyle="none", markersize=5)
        hollow.set_label("not significant" if table.has_p else "not worse")
        keys.append(hollow)
    if table.bound is not None:
        keys.append(Line2D([], [], color=INK, linestyle=(0, (4.0, 2.0)), linewidth=0.9, label=BOUND))
    names = [mark_uncertified(str(o), [c]) for o, c in zip(rows.observer, rows.certified, strict=True)]
    names += [] if table.bound is None else [BOUND]
    least = with_unit(layout.number(float(f"{table.value:.3g}")), unit_of(stats))
    with sheet(paper, title, height=ROW * len(names) + 0.1, keys=keys) as (figure, (ax,)):
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_yticks(range(len(names)), names)
        ax.tick_params(axis="y", length=0)
        ax.grid(False, axis="y")
        ax.set(xlabel=f"relative to {table.best}, {least}")
        _set_ratios(ax, table)
        for place, row in enumerate(cast(list[Row], rows.to_dict("records"))):
            _draw_row(ax, place, row, look[row["observer"]], table, paper)
        ax.axvline(1.0, color=SOFT, linewidth=0.8, zorder=1.2)
        if table.bound is not None:
            low, at, high = table.bound[["ci_low", "mean", "ci_high"]]
            ax.axvline(at, color=INK, linestyle=(0, (4.0, 2.0)), linewidth=0.9, zorder=1.3)
            ax.hlines(len(rows), low, high, color=INK, linewidth=1.3)
            ax.plot([at], [len(rows)], marker="|", color=INK, markersize=8)
    return figure


def _set_ratios(ax: Axes, table: Ratios) -> None:
    """Choose the logarithmic axis of ratios, with room on both sides of 1."""
    values = table.rows[["ratio", "ci_low", "ci_high"]].to_numpy(float).ravel()
    ends = [*values, 1.0, *([] if table.bound is None else table.bound[["mean", "ci_low", "ci_high"]])]
    set_range(ax, "x", ends, log=True)
    low, high = ax.get_xlim()
    if high < NARROW * low:
        room = max(high, 1.0 / low, 1.02)
        set_limits(ax, "x", min(low, 1 / room**0.3), max(high, room), log=True)


def _draw_row(ax: Axes, place: int, row: Row, style: Style, table: Ratios, paper: Paper) -> None:
    ratio, low, high = (row[name] for name in ("ratio", "ci_low", "ci_high"))
    is_best = row["observer"] == table.best
    if np.isfinite(ratio):
        if np.isfinite(low) and not is_best and high > low:
            half = np.sqrt(high / low)
            ax.barh(place, half - 1 / half, left=1 / half, height=2 * THICK, color=GRID, zorder=1)
        ax.hlines(place, low, high, color=style.colour, linewidth=1.5)
        face = style.colour if row["worse"] or is_best else "white"
        ax.plot(
            [ratio],
            [place],
            marker=style.marker,
            color=style.colour,
            mfc=face,
            markersize=5,
            linestyle="none",
            zorder=3,
        )
    ax.text(1.02, place, verdict(row, table), transform=ax.get_yaxis_transform(), va="center_baseline",
            fontsize=paper.size - 1)  # fmt: skip


def verdict(row: Row, table: Ratios) -> str:
    """Return how an observer compares with the best one, in a few words: with the p-value, if there is one."""
    share = f"{100 * row['diverged']:.3g} % diverged" if row["diverged"] else ""
    if row["observer"] == table.best:
        words = "best"
    elif not np.isfinite(row["ratio"]) or row["more"]:
        return share or "no value"
    elif np.isfinite(row["p"]):
        words = f"p < {LEAST:g}" if row["p"] < LEAST else f"p = {row['p']:.2g}"
    elif row["worse"]:
        words = "exact" if table.exact else "no noise"
    else:
        words = "equal" if abs(row["ratio"] - 1) < EQUAL else "no test"
    return ", ".join(filter(None, [words, share]))
