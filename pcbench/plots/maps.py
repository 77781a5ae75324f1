"""Maps over two axes of a study: a metric of each observer, who wins, and how many runs diverge."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.palette import styles
from pcbench.plots.sheet import HEIGHT, WIDTH, sheet, title_of, unit_of

COLUMNS = 3  # of small maps
DARK = 0.55  # of a map's range: beyond, figures stand in white


def heatmaps(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
) -> Figure:
    """Return a map of a metric's mean over two axes (None: the first two that vary) for each observer, on one scale.

    Raises UserError where fewer than two axes vary, or for a word that is none.
    """
    whole = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(whole, x, y)
    part = frames.fixed(whole, [x, y], at)
    title = title_of(metric, whole.signal.iloc[0], unit_of(whole))
    return _small_maps(part, x, y, "mean", f"{whole.scenario.iloc[0]}: {title}", "viridis_r", _norm(part["mean"]))


def divergence(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    at: dict[str, Any] | None = None,
) -> Figure:
    """Return a map over two axes of the share of runs that diverged, for each observer, in per cent."""
    whole = frames.rows(result, scenario, None, "divergence")
    x, y = two_axes(whole, x, y)
    part = frames.fixed(whole, [x, y], at)
    part = part.assign(share=100 * part["mean"])
    return _small_maps(part, x, y, "share", f"{whole.scenario.iloc[0]}: diverged runs [%]", "Reds", Normalize(0, 100))


def winners(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
) -> Figure:
    """Return a map over two axes of who wins, in its colour; blank where the best is not surely so (5 %, Holm)."""
    whole = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(whole, x, y)
    part = (
        frames.fixed(frames.winners(result, scenario, signal, metric), [x, y], at)
        if len(frames.varying(whole))
        else whole
    )
    look = styles(whole.observer)
    xs, ys = _values(part, x), _values(part, y)
    figure, ((ax,),) = sheet()
    for row in part.to_dict("records"):
        i, j = xs.index(row[x]), ys.index(row[y])
        colour = look[row["winner"]].colour if row["winner"] else "white"
        ax.add_patch(_square(i, j, colour))
        ax.text(
            i,
            j,
            row["winner"] or "tie",
            ha="center",
            va="center",
            fontsize=8,
            color="white" if row["winner"] else "#777777",
        )
    _frame(ax, xs, ys, x, y)
    ax.set_title(
        f"{whole.scenario.iloc[0]}: least {title_of(metric, whole.signal.iloc[0], '')}", loc="left", fontsize=10
    )
    names = [name for name in look if name in set(part.winner)]
    handles = [Patch(color=look[name].colour, label=name) for name in names]
    figure.legend(handles=handles, loc="outside right upper", frameon=False, fontsize=8)
    return figure


def two_axes(part: pd.DataFrame, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the two axes of a map: those that are given, or the first that vary; raise UserError where there are not two."""
    found = frames.varying(part)
    chosen = [name for name in (x, y) if name] + [name for name in found if name not in (x, y)]
    if len(chosen) < 2 or chosen[0] not in found or chosen[1] not in found:
        raise UserError(
            f"map of {part.scenario.iloc[0]}: got axes that vary: {', '.join(found) or 'none'}, expected two; give the study "
            "two axes with several values each, or name two of these."
        )
    return chosen[0], chosen[1]


def _small_maps(part: pd.DataFrame, x: str, y: str, value: str, title: str, colours: str, norm: Any) -> Figure:
    names = list(dict.fromkeys(part.observer))
    rows = -(-len(names) // COLUMNS)
    wide = min(len(names), COLUMNS)
    figure, axes = sheet(rows, wide, WIDTH * max(wide, 1.2) / 2 + 1, HEIGHT * rows * 0.75 + 0.4)
    xs, ys, picture = _values(part, x), _values(part, y), None
    for ax, name in zip(axes.flat, names, strict=False):
        mine = part[part.observer == name]
        grid = np.full((len(ys), len(xs)), np.nan)
        for row in mine.to_dict("records"):
            grid[ys.index(row[y]), xs.index(row[x])] = row[value]
        picture = ax.imshow(grid, origin="lower", aspect="auto", cmap=colours, norm=norm)
        for (j, i), number in np.ndenumerate(grid):
            if np.isfinite(number) and grid.size <= 36:
                dark = norm(number) > DARK
                ax.text(i, j, f"{number:.3g}", ha="center", va="center", fontsize=7, color="white" if dark else "black")
        _frame(ax, xs, ys, x, y)
        ax.set_title(name, loc="left", fontsize=9)
    for ax in list(axes.flat)[len(names) :]:
        ax.set_visible(False)
    figure.suptitle(title, fontsize=10)
    if picture is not None:
        figure.colorbar(picture, ax=axes, shrink=0.8)
    return figure


def _frame(ax: Axes, xs: list[Any], ys: list[Any], x: str, y: str) -> None:
    ax.set_xlim(-0.5, len(xs) - 0.5)
    ax.set_ylim(-0.5, len(ys) - 0.5)
    ax.set_xticks(range(len(xs)), [_said(v) for v in xs], fontsize=8)
    ax.set_yticks(range(len(ys)), [_said(v) for v in ys], fontsize=8)
    ax.set_xlabel(frames.label(x))
    ax.set_ylabel(frames.label(y))


def _square(i: int, j: int, colour: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((i - 0.5, j - 0.5), 1, 1, facecolor=colour, edgecolor="#CCCCCC")


def _values(part: pd.DataFrame, axis: str) -> list[Any]:
    found = list(dict.fromkeys(part[axis]))
    return sorted(found) if all(isinstance(v, int | float) for v in found) else found


def _said(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _norm(values: pd.Series) -> Any:
    found = values[np.isfinite(values)]
    if not len(found):
        return Normalize(0, 1)
    low, high = float(found.min()), float(found.max())
    return LogNorm(low, high) if low > 0 and high > 10 * low else Normalize(low, high)
