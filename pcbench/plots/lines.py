"""Lines: how errors are distributed over runs, how a metric moves with one axis of a study, and what more seeds are worth.

Simulated means against exact ones: distances in standard errors, sorted, over the normal quantiles they should have.

What an observer is worth against what it costs.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.special import ndtri

from pcbench.dataset.result import Result
from pcbench.dataset.validate_exact import Checked
from pcbench.errors import UserError, unknown
from pcbench.plots import frames, layout
from pcbench.plots.labels import about, title_of, unit_of
from pcbench.plots.layout import PAPER, Key, Panel, Paper, drawn_on, sheet
from pcbench.plots.palette import SOFT, Style, styles

APART = 0.012  # of an axis' length, between points of observers at one value
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
    """Return the empirical distribution of a metric over runs, a line for each observer; left is better.

    `cell` is the number of the combination of axis values. An observer whose runs diverge ends below 1. Raises UserError for
    an unknown word.
    """
    part = frames.distribution(result, scenario, signal, metric, cell)
    named = frames.rows(result, scenario, signal, metric)
    names = list(dict.fromkeys(named.observer))
    x = layout.of(part.value, layout.is_wide(part.value))
    y = layout.Scale(0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0), ("0", "25 %", "50 %", "75 %", "100 %"))
    title = title_of(metric, named.signal.iloc[0], unit_of(named))
    keys = keys_of(names)
    panel = Panel(x, y, title, "share of runs")
    figure, (ax,) = sheet(paper, about(result, named, frames.values_at(named, cell)), [panel], keys)
    with drawn_on(paper):
        for key in keys:
            mine = part[part.observer == key.label]
            if len(mine):
                start = pd.Series([mine.value.iloc[0]])
                values, share = pd.concat([start, mine.value]), pd.concat([pd.Series([0.0]), mine.share])
                ax.step(values, share, where="post", label=key.label, **line(key))
    return figure


def curves(
    result: Result,
    axis: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return the mean of a metric over one axis of the study (None: the first that varies), with 95 % intervals.

    The other axes stand at their first value, or where `at` says. Points of one value stand a little apart. Raises UserError
    where no axis varies, or for a word that is none.
    """
    whole = frames.rows(result, scenario, signal, metric)
    axis = axis or next(iter(frames.varying(whole)), None)
    if axis is None or axis not in frames.varying(whole):
        raise UserError(
            f"curves of {whole.scenario.iloc[0]}: got axis {axis!r}, expected one that varies "
            f"({', '.join(frames.varying(whole)) or 'none does'}); give the study an axis with more than one value."
        )
    part = frames.fixed(whole, [axis], at)
    every = list(dict.fromkeys(part[axis]))
    names = list(dict.fromkeys(whole.observer))
    ends = part[["mean", "ci_low", "ci_high"]].to_numpy()
    x, y = layout.at(every), layout.of(ends, layout.is_wide(ends))
    keys = keys_of(names, "points")
    panel = Panel(
        x, y, frames.label(axis, frames.units(result, whole)), title_of(metric, whole.signal.iloc[0], unit_of(whole))
    )
    others = {a: v for a, v in frames.values_at(part, int(part.cell.iloc[0])).items() if a != axis}
    others |= {a: part[a].iloc[0] for a in frames.varying(whole) if a != axis}
    figure, (ax,) = sheet(paper, about(result, whole, others), [panel], keys)
    with drawn_on(paper):
        for i, key in enumerate(keys):
            mine = part[part.observer == key.label]
            moved = APART * (i - (len(keys) - 1) / 2)
            found = np.array(_beside(layout.places(x, list(mine[axis]), every), x, moved))
            where, mine = np.sort(found), mine.iloc[np.argsort(found)]
            faint = 0.45 if len(every) < FEW else 1.0
            ax.plot(where, mine["mean"], color=key.style.colour, linestyle=key.style.line, linewidth=1.1, alpha=faint)
            ax.vlines(where, mine.ci_low, mine.ci_high, color=key.style.colour, linewidth=1.3)
            ax.plot(where, mine["mean"], label=key.label, color=key.style.colour, marker=key.style.marker, markersize=4,
                    linestyle="none")  # fmt: skip
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
    """Return how wide the 95 % interval of a mean is after ever more seeds, as a part of the mean, beside 1 / sqrt(seeds).

    Raises UserError for an unknown word.
    """
    named = frames.rows(result, scenario, signal, metric)
    part = frames.convergence(result, scenario, signal, metric, cell)
    names = [n for n in dict.fromkeys(named.observer) if n in set(part.observer)]
    keys = [*keys_of(names), Key("1/√seeds", Style(SOFT, (1.0, 1.0), ""), width=0.9)]
    x = layout.at(sorted(set(part.seeds)) or [1, 2])
    y = layout.of(100 * part.half, log=True)
    title = f"± of {title_of(metric, named.signal.iloc[0], '')} [% of it]"
    figure, (ax,) = sheet(
        paper, about(result, named, frames.values_at(named, cell)), [Panel(x, y, "seeds", title)], keys
    )
    with drawn_on(paper):
        for key in keys[:-1]:
            mine = part[part.observer == key.label]
            ax.plot(mine.seeds, 100 * mine.half, label=key.label, marker=key.style.marker, markersize=3.5, **line(key))
        if len(part):
            seeds = np.array([part.seeds.min(), part.seeds.max()])
            last = 100 * part[part.seeds == seeds[1]].half.median()
            ax.plot(
                seeds, last * np.sqrt(seeds[1] / seeds), color=SOFT, linestyle=(0, (1.0, 1.0)), linewidth=0.9, zorder=1
            )
    return figure


def keys_of(names: Iterable[str], kind: str = "line") -> list[Key]:
    """Return a key for each observer: the first is drawn broadest and lowest, so that none hides another."""
    look = styles(names)
    many = len(look)
    return [Key(n, s, kind, 1.3 + min(0.45, 1.6 / many) * (many - 1 - i)) for i, (n, s) in enumerate(look.items())]


def line(key: Key) -> dict[str, Any]:
    """Return how matplotlib draws an observer's line."""
    return {"color": key.style.colour, "linewidth": key.width, "linestyle": key.style.line}


def _beside(where: list[float], x: layout.Scale, by: float) -> list[float]:
    """Places on an axis moved by a part of its length."""
    if x.log:
        return [v * (x.high / x.low) ** by for v in where]
    return [v + (x.high - x.low) * by for v in where]


def quantiles(found: Checked, *, paper: Paper = PAPER) -> Figure:
    """Return the quantile plot of a comparison: points on the line are chance. Raises UserError where there is none to draw."""
    rows = found.rows[np.isfinite(found.rows.z)].sort_values("z", kind="stable")
    if rows.empty:
        raise UserError("plots.quantiles: got no mean that varies, expected some; run a study with noise.")
    expected = ndtri((np.arange(len(rows)) + 0.5) / len(rows))
    keys = keys_of(dict.fromkeys(sorted(rows.observer)))
    panel = Panel(
        layout.of(expected),
        layout.of([*rows.z, *expected]),
        "normal quantile",
        "(mean less exact) / standard error",
        2.4,
    )
    figure, (ax,) = sheet(paper, f"{len(rows):,} simulated means against exact values", [panel], keys)
    with drawn_on(paper):
        ends = [expected[0], expected[-1]]
        ax.plot(ends, ends, color=SOFT, linewidth=0.8, zorder=1)
        for key in keys:
            mine = (rows.observer == key.label).to_numpy()
            ax.scatter(expected[mine], rows.z[mine], s=7, color=key.style.colour, linewidths=0, label=key.label)
    return figure


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
    x = layout.of(both[by], layout.is_wide(both[by]), margin=0.12)
    y = layout.of(both[["mean", "ci_low", "ci_high"]], layout.is_wide(both["mean"]), margin=0.12)
    panel = Panel(x, y, WORDS[by], title_of(metric, row.signal, row.unit))
    keys = [Key(o, look[o], "points", 0.0) for o in both.observer]
    figure, (ax,) = sheet(paper, about(result, chosen, frames.values_at(whole, cell)), [panel], keys)
    with drawn_on(paper):
        for one in both.to_dict("records"):
            style = look[one["observer"]]
            ax.vlines(one[by], one["ci_low"], one["ci_high"], colors=style.colour, linewidth=1.2)
            ax.scatter([one[by]], [one["mean"]], c=style.colour, marker=style.marker, s=26, zorder=3)
    return figure
