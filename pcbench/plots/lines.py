"""Line figures: distributions over runs, a metric over one axis of a study, and the width of intervals over the number of runs.

Also a quantile plot of simulated means against exact ones, and a metric over operation counts.
"""

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.transforms import offset_copy
from scipy.special import ndtri

from pcbench.dataset.result import Result
from pcbench.dataset.validate_exact import ExactValidation
from pcbench.errors import UserError, unknown
from pcbench.plots import crossings, frames
from pcbench.plots.labels import about, title_of, unit_of
from pcbench.plots.layout import (
    PAPER,
    Paper,
    ends_in_infinity,
    is_positive,
    is_wide,
    set_limits,
    set_range,
    set_values,
    sheet,
)
from pcbench.plots.palette import SOFT, LineLook, styles
from pcbench.statistics.consistency import BANDS
from pcbench.toml_text import TomlTable

DISTINCT = 1.4  # ratio of two ticks of a number of runs, at least
APART = 2.2  # points of the page, between points of observers at one value that is a word
CROSSED = ("processor_speed",)  # axes along which crossings are marked
FEW = 5  # points that are joined by a faint line only: between them nothing was computed


def distributions(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    cell: int = 0,
    paper: Paper = PAPER,
) -> Figure:
    """Return the empirical distribution of a metric over runs, one line per observer; further left is better.

    `cell` is the number of the grid point. The line of an observer whose runs diverge ends below 1. Raises UserError for an
    unknown name.
    """
    part = frames.distribution(result, scenario, signal, metric, cell)
    stats = frames.rows(result, scenario, signal, metric)
    with sheet(paper, about(result, stats, frames.named_values(result, stats, cell))) as (figure, (ax,)):
        set_range(ax, "x", part.value, is_positive(part.value))
        set_limits(ax, "y", 0.0, 1.0)
        ax.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        ax.set(title="share of runs", xlabel=title_of(metric, stats.signal.iloc[0], unit_of(stats)))
        for observer, line in lines(stats.observer).items():
            rows = part[part.observer == observer]
            first = rows.value.head(1)
            ax.step([*first, *rows.value], [*(0.0 for _ in first), *rows.share], where="post", **line)
    return figure


def curves(
    result: Result,
    axis: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, object] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return the mean of a metric over one axis of the study (None: the first that varies), with 95 % intervals.

    The other axes have their first value, or that in `at`. The axis of positive values is logarithmic. Points of one value are
    drawn side by side if it is a word. Along `processor_speed`, dotted lines show where the best observer changes
    significantly, with 95 % intervals (`crossings`). Raises UserError if no axis varies, or for an unknown name.
    """
    selection: TomlTable = {"scenario": scenario, "signal": signal, "metric": metric, "at": at}
    stats = frames.rows(result, scenario, signal, metric)
    axis = axis or next(iter(frames.varying_axes(stats)), None)
    if axis is None or axis not in frames.varying_axes(stats):
        raise UserError(
            f"curves of {stats.scenario.iloc[0]}: got axis {axis!r}, expected one that varies "
            f"({', '.join(frames.varying_axes(stats)) or 'none does'}); give the study an axis with more than one value."
        )
    part = frames.fix_axes(stats, [axis], at)
    axis_values = list(dict.fromkeys(part[axis]))
    title_values = frames.named_values(result, stats, int(part.cell.iloc[0]))
    title_values = {a: value for a, value in title_values.items() if a != axis}
    ends = part[["mean", "ci_low", "ci_high"]].to_numpy()
    with sheet(paper, about(result, stats, title_values)) as (figure, (ax,)):
        place = set_values(ax, "x", axis_values, frames.INFINITE.get(axis, "∞"))
        set_range(ax, "y", [*ends.ravel(), *[1.0] * (metric in BANDS)], is_positive(ends))
        is_finite = all(isinstance(v, int | float) and np.isfinite(v) for v in axis_values)
        numeric = is_finite or ends_in_infinity(axis_values)
        ax.set_title(title_of(metric, stats.signal.iloc[0], unit_of(stats)))
        ax.set_xlabel(frames.label(axis, frames.axis_titles(result, stats)))
        look = styles(stats.observer)
        for i, (observer, style) in enumerate(look.items()):
            rows = part[part.observer == observer]
            x = np.array([place(value) for value in rows[axis]])
            rows, x = rows.iloc[np.argsort(x)], np.sort(x)
            offset = 0.0 if numeric else APART * (i - (len(look) - 1) / 2)
            transform = offset_copy(ax.transData, figure, offset, units="points")
            ax.vlines(x, rows.ci_low, rows.ci_high, color=style.colour, linewidth=1.3, transform=transform)
            faint = to_rgba(style.colour, 0.45 if len(axis_values) < FEW else 1.0)
            marker: TomlTable = {"marker": style.marker, "markersize": 4, "mfc": style.colour, "mec": style.colour}
            n_finite = len(rows) - ends_in_infinity(axis_values)  # what is beyond all numbers is not
            ax.plot(x[:n_finite], rows["mean"][:n_finite], label=observer, color=faint, linestyle=style.line, linewidth=1.1,
                    transform=transform, **marker)  # fmt: skip
            ax.plot(x[n_finite:], rows["mean"][n_finite:], linestyle="none", transform=transform, **marker)
        if metric in BANDS:
            ax.axhline(1.0, color=SOFT, linewidth=0.9, zorder=1.2)
        for crossing in crossings.changes(result, axis, **selection) if axis in CROSSED else []:
            ax.axvspan(crossing.low, crossing.high, color=SOFT, alpha=0.25, linewidth=0, zorder=0.5)
            ax.axvline(crossing.value, color=SOFT, linestyle=":", linewidth=0.9, zorder=0.6)
    return figure


def convergence(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    cell: int = 0,
    paper: Paper = PAPER,
) -> Figure:
    """Return half the 95 % interval of a mean, relative to the mean, over the number of runs, with a line 1 / sqrt(runs).

    Raises UserError for an unknown name.
    """
    stats = frames.rows(result, scenario, signal, metric)
    part = frames.convergence(result, scenario, signal, metric, cell)
    look = styles(stats.observer)
    with sheet(paper, about(result, stats, frames.named_values(result, stats, cell))) as (figure, (ax,)):
        runs = sorted(set(part.seeds)) or [1, 2]  # each time twice as many
        set_range(ax, "x", runs, log=True)
        ticks = [n for n in runs if n == runs[-1] or DISTINCT * n < runs[-1]]  # an observer that lost runs ends between
        ax.set_xticks(ticks, [f"{n}" for n in ticks])
        set_range(ax, "y", 100 * part.half, log=True)
        ax.set(title=f"half 95 % interval of {title_of(metric, stats.signal.iloc[0], '')} [% of it]", xlabel="runs")
        for observer, line in lines(n for n in look if n in set(part.observer)).items():
            rows = part[part.observer == observer]
            ax.plot(rows.seeds, 100 * rows.half, marker=look[observer].marker, markersize=3.5, **line)
        seeds = np.array(runs)
        last = 100 * part[part.seeds == part.seeds.max()].half.median()
        ax.plot(seeds, last * np.sqrt(seeds[-1] / seeds), label="1/√runs", color=SOFT, linestyle=":", linewidth=0.9)
    return figure


def lines(names: Iterable[str]) -> dict[str, LineLook]:
    """Return how matplotlib draws each observer's line: the first is broadest and lowest, so that none hides another."""
    look = styles(names)
    widths = 1.3 + min(0.45, 1.6 / max(len(look), 1)) * np.arange(len(look))[::-1]
    return {
        name: {"label": name, "color": style.colour, "linestyle": style.line, "linewidth": width}
        for (name, style), width in zip(look.items(), widths, strict=True)
    }


def quantiles(found: ExactValidation, *, paper: Paper = PAPER) -> Figure:
    """Return the quantile plot of simulated against exact means: chance alone puts the points on the line.

    Raises UserError if no mean varies.
    """
    rows = found.rows[np.isfinite(found.rows.z)].sort_values("z", kind="stable")
    if rows.empty:
        raise UserError("plots.quantiles: got no mean that varies, expected at least one; run a study with noise.")
    expected = ndtri((np.arange(len(rows)) + 0.5) / len(rows))
    with sheet(paper, f"{len(rows):,} simulated means against exact values", height=2.4) as (figure, (ax,)):
        set_range(ax, "x", expected, log=False)
        set_range(ax, "y", [*rows.z, *expected], log=False)
        ax.set(title="(mean - exact) / standard error", xlabel="normal quantile")
        ax.plot(expected[[0, -1]], expected[[0, -1]], color=SOFT, linewidth=0.8, zorder=1)
        for observer, style in styles(sorted(rows.observer)).items():
            mask = (rows.observer == observer).to_numpy()
            ax.scatter(expected[mask], rows.z[mask], s=7, color=style.colour, linewidths=0, label=observer)
    return figure


COSTS = {"sample": "multiplications per sample", "tick": "multiplications per tick", "memory": "bytes of memory"}


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
    """Return a metric of every observer of a grid point over its operation counts (`pcbench.operation_counts`).

    `by` is sample, tick or memory. Raises UserError for another name.
    """
    if by not in COSTS:
        raise unknown("cost", "operation count", by, COSTS)
    stats = frames.rows(result, scenario, signal, metric)
    rows = stats[stats.cell == cell]
    points = rows.merge(costs[["scenario", "cell", "observer", *COSTS]], on=["scenario", "cell", "observer"])
    points = points[(points[by] > 0) & points["mean"].notna()]  # what costs nothing has no place on a scale of factors
    look, row = styles(points.observer), rows.iloc[0]
    with sheet(paper, about(result, rows, frames.named_values(result, stats, cell))) as (figure, (ax,)):
        wide = is_wide(points[by])
        set_range(ax, "x", points[by] if wide else [0.0, *points[by]], wide, margin=0.12)
        set_range(ax, "y", points[["mean", "ci_low", "ci_high"]], is_wide(points["mean"]), margin=0.12)
        ax.set(title=title_of(metric, row.signal, row.unit), xlabel=COSTS[by])
        for point in points.to_dict("records"):
            style = look[point["observer"]]
            ax.vlines(point[by], point["ci_low"], point["ci_high"], colors=style.colour, linewidth=1.2)
            ax.scatter(
                [point[by]],
                [point["mean"]],
                c=style.colour,
                marker=style.marker,
                s=26,
                zorder=3,
                label=point["observer"],
                clip_on=False,  # an error of 0 lies on the axis
            )
    return figure
