"""Maps of many cells side by side: an image each, with labelled lines of equal value and marks; no words in cells.

Maps over two axes of a study: a metric of each observer, who wins and how surely, and how many runs diverge.
"""

from collections.abc import Callable, Mapping
from functools import partial
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, to_hex, to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames, layout, small_maps
from pcbench.plots.labels import about, named, times, title_of, unit_of
from pcbench.plots.layout import PAPER, Key, Panel, Paper, drawn_on, sheet, width_of
from pcbench.plots.palette import INK, Style, pale, styles
from pcbench.plots.small_maps import Cell, Map, Over, grid_of, levels_of

FINE = 24  # values of an axis beyond which a map is an image
SIDE = 2.2  # inches of a map
TICKS = 6  # words on an axis, about

Marks = Mapping[str, tuple[Any, Any]]  # by what is said of it, a place: values of both axes, not only those of cells


def is_fine(x: Over, y: Over) -> bool:
    """Say whether a map over two axes is drawn as an image."""
    numbers = all(isinstance(v, int | float) for v in (*x.values, *y.values))
    return numbers and max(len(x.values), len(y.values)) > FINE


def drawn(
    maps: list[Map], x: Over, y: Over, title: str, keys: list[Key], paper: Paper, log: bool, marks: Marks
) -> Figure:
    """Draw maps side by side, as many as two columns of the paper hold."""
    across, up = _thinned(x), _thinned(y)
    room = max(width_of(w, paper.size - 1, paper.font) for w in up.words) + 2 * paper.em
    columns = max(1, min(len(maps), int(2 * paper.width / (SIDE + room))))
    panels = []
    for i, each in enumerate(maps):
        above = [each.title, f"↑ {y.title}" if i % columns == 0 else ""]
        below = x.title if i + columns >= len(maps) else ""
        panels.append(Panel(across, up, below, "\n".join(filter(None, above)) or " ", SIDE, grid=False))
    figure, axes = sheet(paper, title, panels, keys, columns, columns * (SIDE + room))
    with drawn_on(paper):
        for ax, each in zip(axes, maps, strict=True):
            _filled(ax, each, x, y, paper, log)
            _marked(ax, x, y, marks, paper)
    return figure


def _thinned(over: Over) -> layout.Scale:
    """An axis of cells with ticks at some of their values, the first and others as far apart."""
    many = len(over.values)
    kept = tuple(range(0, many, -(-many // TICKS)))
    return layout.Scale(-0.5, many - 0.5, kept, tuple(layout.word(over.values[i]) for i in kept))


def _filled(ax: Axes, each: Map, x: Over, y: Over, paper: Paper, log: bool) -> None:
    image = np.ones((len(y.values), len(x.values), 3))
    rows, columns = ({v: i for i, v in enumerate(over.values)} for over in (y, x))
    for (a, b), cell in each.cells.items():
        image[rows[b], columns[a]] = to_rgb(cell.colour)
    ends = (-0.5, len(x.values) - 0.5, -0.5, len(y.values) - 0.5)
    ax.imshow(image, origin="lower", aspect="auto", interpolation="nearest", extent=ends, zorder=0.5)
    grid = grid_of(each, x, y)
    if levels := levels_of(grid, log):
        lines = ax.contour(range(len(x.values)), range(len(y.values)), grid, levels=levels, colors=INK, linewidths=0.6)
        ax.clabel(lines, fmt=dict(zip(levels, map(layout.number, levels), strict=True)), fontsize=paper.size - 2)


def _marked(ax: Axes, x: Over, y: Over, marks: Marks, paper: Paper) -> None:
    """Draw a cross at each mark and what is said of it beside, on the side that has room."""
    for said, (a, b) in marks.items():
        at, high = _place(a, x), _place(b, y)
        left = at > 0.7 * len(x.values)
        ax.plot([at], [high], marker="x", color=INK, markersize=paper.size * 0.6, markeredgewidth=1.2)
        ax.annotate(
            said, (at, high), (-5 if left else 5, 4), textcoords="offset points",
            ha="right" if left else "left", fontsize=paper.size - 1, color=INK,
        )  # fmt: skip


def _place(value: float, over: Over) -> float:
    """Where a value of an axis stands among its cells."""
    found: NDArray[np.float64] = np.asarray(over.values, float)
    return float(np.interp(value, found, np.arange(len(found))))


ERRORS = LinearSegmentedColormap.from_list("errors", ["#F3F6FA", "#A9C1DA", "#5A88B8", "#1B4674"])  # dark: more
LOST = LinearSegmentedColormap.from_list("lost", ["#FFFFFF", "#F0C9A8", "#C77B3B", "#7A3E0C"])
NOTHING = "#FFFFFF"  # of a cell in which every run diverged
MOST = 12  # panels of a map of winners


def heatmaps(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
    marks: Marks = MappingProxyType({}),
    paper: Paper = PAPER,
) -> Figure:
    """Return a map of a metric's mean over two axes (None: the first two that vary) for each observer, on one scale.

    Where an axis has more than 24 values it is an image, with lines of equal value, and `marks` on it: by what is said of each,
    its place (x, y). Raises UserError where fewer than two axes vary, or for a word that is none.
    """
    whole = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(whole, x, y)
    part = frames.fixed(whole, [x, y], at)
    title = title_of(metric, whole.signal.iloc[0], unit_of(whole))
    held = {name: part[name].iloc[0] for name in frames.varying(whole) if name not in (x, y)}
    part = part.assign(value=part["mean"])
    return _maps(result, part, (x, y), title, held, ERRORS, _norm(part["mean"]), paper, marks)


def divergence(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    at: dict[str, Any] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return a map over two axes of the share of runs that diverged, for each observer, in per cent."""
    whole = frames.rows(result, scenario, None, "divergence_rate")
    x, y = two_axes(whole, x, y)
    part = frames.fixed(whole, [x, y], at)
    held = {name: part[name].iloc[0] for name in frames.varying(whole) if name not in (x, y)}
    part = part.assign(value=100 * part["mean"], unit="%")
    return _maps(result, part, (x, y), "diverged runs [%]", held, LOST, Normalize(0, 100), paper)


def winners(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return a map over two axes of who wins, in its colour, and by which factor it is ahead of the second.

    Where the best is not surely better than every other (5 %, Holm) its colour is pale, and the cell says with whom it ties.
    Other axes that vary have a map for each of their values, where these are few and `at` says nothing of them.
    """
    whole = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(whole, x, y)
    others = [n for n in frames.varying(whole) if n not in (x, y, *(at or {}))]
    found = frames.fixed(frames.standings(result, scenario, signal, metric), [x, y, *others], at)
    if len(found.groupby(others, sort=False) if others else []) > MOST:
        found = frames.fixed(found, [x, y])
    groups = list(found.groupby(others, sort=False)) if others else [((), found)]
    look = styles(whole.observer)
    made = [
        Map(
            ", ".join(frames.said(n, v) for n, v in zip(others, key, strict=True)),
            _cells(mine, x, y, partial(_won, look)),
        )
        for key, mine in groups
    ]
    keys = [Key(name, look[name], "patch") for name in look if name in set(found.best)]
    title = f"least {named(metric, whole.signal.iloc[0])}, {about(result, whole, at or {})}"
    return _drawn(made, _over(result, whole, x), _over(result, whole, y), title, keys, paper, False)


def two_axes(part: pd.DataFrame, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the two axes of a map: those that are given, or the first that vary; raise UserError where there are not two."""
    found = frames.varying(part)
    chosen = [name for name in (x, y) if name] + [name for name in found if name not in (x, y)]
    if len(chosen) < 2 or chosen[0] not in found or chosen[1] not in found:
        raise UserError(
            f"map of {part.scenario.iloc[0]}: got axes that vary: {', '.join(found) or 'none'}, expected two; give the study "
            "two axes with several values each, or name two of these."
        )
    return (chosen[0], chosen[1]) if x or y else frames.map_axes(part)


def _won(look: dict[str, Style], row: dict[str, Any]) -> Cell:
    if not row["best"]:
        return Cell(NOTHING, ("all diverge", "-"), "all runs diverge")
    colour, factor = look[row["best"]].colour, row["factor"]
    ahead = times(factor) if isfinite(factor) and factor > 1 else ""
    if row["winner"]:
        p = f", p {row['p']:.1g}" if isfinite(row["p"]) else ""
        return Cell(colour, (f"{row['best']}\n{ahead}", row["best"]), f"{row['best']} surely{p}, the second {ahead}")
    tied = " = ".join((row["best"], *row["alike"][:1])) + (" …" if len(row["alike"]) > 1 else "")
    return Cell(pale(colour), (f"tie\n{tied}", "tie"), f"tie: {' = '.join((row['best'], *row['alike']))}")


def _maps(
    result: Result,
    part: pd.DataFrame,
    axes: tuple[str, str],
    title: str,
    held: dict[str, Any],
    colours: Any,
    norm: Any,
    paper: Paper,
    marks: Marks = MappingProxyType({}),
) -> Figure:
    """Draw a map of the column `value` for each observer, in colours."""
    x, y = axes

    def painted(row: dict[str, Any]) -> Cell:
        value, unit = row["value"], str(row.get("unit", ""))
        if not isfinite(value):
            return Cell(NOTHING, ("all diverged", "-"), f"{row['observer']}: all runs diverged")
        tip = f"{row['observer']}: {layout.number(float(f'{value:.4g}'))} {unit}"
        return Cell(to_hex(colours(float(norm(value)))), (layout.short(value),), tip, value)

    maps = [Map(str(o), _cells(mine, x, y, painted)) for o, mine in part.groupby("observer", sort=False)]
    log = isinstance(norm, LogNorm)
    low, high = float(norm.vmin), float(norm.vmax)
    scale = layout.of([low, high], log)
    levels = [(v, said) for v, said in zip(scale.ticks, scale.words, strict=True) if low <= v <= high]
    keys = [Key(said, Style(to_hex(colours(float(norm(v)))), (), ""), "patch") for v, said in levels]
    said = f"{title}, {about(result, part, held)}"
    return _drawn(maps, _over(result, part, x), _over(result, part, y), said, keys, paper, log, marks)


def _drawn(
    maps: list[Map], x: Over, y: Over, title: str, keys: list[Key], paper: Paper, log: bool,
    marks: Marks = MappingProxyType({}),
) -> Figure:  # fmt: skip
    if is_fine(x, y):
        return drawn(maps, x, y, title, keys, paper, log, marks)
    return small_maps.drawn(maps, x, y, title, keys, paper, log)


def _cells(rows: pd.DataFrame, x: str, y: str, cell: Callable[[dict[str, Any]], Cell]) -> dict[tuple[Any, Any], Cell]:
    return {(row[x], row[y]): cell({str(k): v for k, v in row.items()}) for row in rows.to_dict("records")}


def _over(result: Result, part: pd.DataFrame, axis: str) -> Over:
    found = list(dict.fromkeys(part[axis]))
    ordered = sorted(found) if all(isinstance(v, int | float) for v in found) else found
    return Over(frames.label(axis, frames.units(result, part)), ordered)


def _norm(values: pd.Series) -> Any:
    found = values[np.isfinite(values)]
    if not len(found):
        return Normalize(0, 1)
    low, high = float(found.min()), float(found.max())
    if high - low <= layout.SAME * abs(high):
        return Normalize(min(0.0, low), max(0.0, high) or 1.0)
    return (
        LogNorm(low, high)
        if low > 0 and high > 10 * low
        else Normalize(min(low, 0.0) if low < 0.3 * high else low, high)
    )
