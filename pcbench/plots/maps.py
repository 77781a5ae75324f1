"""Maps over two axes of a study: a metric of each observer, winners with their significance, and diverged runs.

A cell is a coloured rectangle with what fits into it. Maps of many cells are an image each, with labelled lines of equal value.
"""

from collections.abc import Callable, Hashable, Mapping
from math import ceil, isfinite
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames, layout
from pcbench.plots.labels import about, describe_metric, times, title_of, unit_of
from pcbench.plots.layout import PAPER, Paper, sheet
from pcbench.plots.palette import GRID, INK, SOFT, Style, ink_on, pale, styles
from pcbench.statistics.aggregate import Row

FINE = 16  # values of an axis beyond which a map is an image
SIDE = 2.2  # inches of an image
LINES = 6  # values of both axes from which on lines of equal value are drawn
ROW, TALL = 0.42, 2.6  # inches of a cell, where there are few; of a map, where there are many
KEYS = 4  # colours in the legend
LEAST = 8  # letters' heights that a map is wide
SAME = 1e-3  # a map whose values differ by a smaller part is of one colour, and has no lines
ERRORS = LinearSegmentedColormap.from_list("errors", ["#F3F6FA", "#A9C1DA", "#5A88B8", "#1B4674"])  # dark: more
LOST = LinearSegmentedColormap.from_list("lost", ["#FFFFFF", "#F0C9A8", "#C77B3B", "#7A3E0C"])
NO_VALUE = "#FFFFFF"  # of a cell in which every run diverged
MOST = 12  # panels of a map of winners

Marks = Mapping[str, tuple[float, float]]  # by its label, a place: values of both axes, not only those of cells


class Cell(NamedTuple):
    """One cell of a map."""

    colour: str
    words: tuple[str, ...] = ()  # the longest first: the first that fits is written
    tip: str = ""  # all of it in words
    value: float = np.nan  # of which lines of equal value are drawn


class Side(NamedTuple):
    """One of the two axes of all maps."""

    title: str
    values: list[Any]
    infinite: str = "∞"

    @property
    def words(self) -> list[str]:
        """Return the values in words."""
        return [layout.word(value, self.infinite) for value in self.values]


Cells = Mapping[tuple[Hashable, Hashable], Cell]  # by the values of both axes


def heatmaps(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, object] | None = None,
    marks: Marks = MappingProxyType({}),
    paper: Paper = PAPER,
) -> Figure:
    """Return a map of a metric's mean over two axes (None: the first two that vary) for each observer, on one scale.

    If an axis has more than 24 values, the map is an image with lines of equal value. `marks` are points (x, y) by their label.
    Raises UserError if fewer than two axes vary, or for an unknown name.
    """
    stats = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(stats, x, y)
    part = frames.fix_axes(stats, [x, y], at)
    values, unit, colours = part["mean"], unit_of(stats), ERRORS
    norm, title = _norm(values), title_of(metric, stats.signal.iloc[0], unit)
    if metric == "divergence_rate":
        values, unit, colours = 100 * values, "%", LOST
        norm, title = Normalize(0, 100), "diverged runs [%]"
        part = part[part.observer.isin(diverging(part) or part.observer)]

    def cell(row: Row) -> Cell:
        value = row["value"]
        if not isfinite(value):
            why = "all diverged" if row["diverged"] else "infinite" if np.isinf(value) else "no value"
            return Cell(NO_VALUE, (why, "-"), f"{row['observer']}: {why.replace('all', 'all runs')}")
        tip = f"{row['observer']}: {layout.number(float(f'{value:.4g}'))} {unit}"
        return Cell(to_hex(colours(norm(value))), (layout.short(value),), tip, value)

    groups = part.assign(value=values).groupby("observer", sort=False)
    maps = [(str(observer), _cells(group, x, y, cell)) for observer, group in groups]
    log = isinstance(norm, LogNorm)
    scale, (low, high) = np.geomspace if log else np.linspace, np.array([norm.vmin, norm.vmax], float)
    keys = [Patch(facecolor=colours(norm(v)), edgecolor=SOFT, linewidth=0.4, label=layout.short(v))
            for v in scale(low, high, KEYS)]  # fmt: skip
    title_values = {name: part[name].iloc[0] for name in frames.varying_axes(stats) if name not in (x, y)}
    title = f"{title}, {about(result, part, title_values)}"
    return draw(maps, _side(result, part, x), _side(result, part, y), title, keys, paper, log, marks)


def divergence(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    at: dict[str, object] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return a map over two axes of the percentage of diverged runs, for each observer that diverges."""
    return heatmaps(result, x, y, scenario=scenario, metric="divergence_rate", at=at, paper=paper)


def diverging(part: pd.DataFrame) -> list[str]:
    """Return the observers of which a run diverges, from rows of divergence rates."""
    return list(dict.fromkeys(part.observer[part["mean"] > 0]))


def winners(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, object] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return a map of the winners over two axes, in their colours, with the error of the second relative to the winner's.

    If the best is not significantly better than every other (5 %, Holm), its colour is pale, and the map names the observer it
    ties with. Each combination of the other varying axes has its own map, if there are few and `at` does not fix them.
    """
    stats = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(stats, x, y)
    panel_axes = [n for n in frames.varying_axes(stats) if n not in (x, y, *(at or {}))]
    standings = frames.fix_axes(frames.standings(result, scenario, signal, metric), [x, y, *panel_axes], at)
    if len(standings.groupby(panel_axes, sort=False) if panel_axes else []) > MOST:
        standings = frames.fix_axes(standings, [x, y])
    groups = list(standings.groupby(panel_axes, sort=False)) if panel_axes else [((), standings)]
    look = styles(stats.observer)
    titles = frames.axis_titles(result, stats)
    maps = [
        (", ".join(frames.format_axis(n, v, titles) for n, v in zip(panel_axes, key, strict=True)),
         _cells(group, x, y, lambda row: _standing(look, row)))
        for key, group in groups
    ]  # fmt: skip
    keys = [Patch(color=style.colour, label=name) for name, style in look.items() if name in set(standings.best)]
    title = f"winner by {describe_metric(metric, stats.signal.iloc[0])}, {about(result, stats, at or {})}"
    return draw(maps, _side(result, stats, x), _side(result, stats, y), title, keys, paper)


def two_axes(part: pd.DataFrame, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the two axes of a map: x and y, or the first that vary; raise UserError if there are not two."""
    axes = frames.varying_axes(part)
    names = [name for name in (x, y) if name] + [name for name in axes if name not in (x, y)]
    if len(names) < 2 or names[0] not in axes or names[1] not in axes:
        raise UserError(
            f"map of {part.scenario.iloc[0]}: got axes that vary: {', '.join(axes) or 'none'}, expected two; give the study "
            "two axes with several values each, or name two of these."
        )
    return (names[0], names[1]) if x or y else frames.map_axes(part)


def _standing(look: dict[str, Style], row: Row) -> Cell:
    if not row["best"]:
        return Cell(NO_VALUE, (row["text"], "-"), row["text"].replace("all", "all runs"))
    colour, factor = look[row["best"]].colour, row["factor"]
    lead = times(factor) if isfinite(factor) and factor > 1 else ""
    if row["winner"]:
        p = f", p {row['p']:.1g}" if isfinite(row["p"]) else ""
        return Cell(
            colour,
            (f"{row['best']}\n{lead}", row["best"], lead),
            f"{row['best']} significantly better{p}, second {lead}",
        )
    names = " = ".join((row["best"], *row["alike"][:1])) + (" …" if len(row["alike"]) > 1 else "")
    return Cell(pale(colour), (f"tie\n{names}", "tie"), f"tie: {' = '.join((row['best'], *row['alike']))}")


def _cells(rows: pd.DataFrame, x: str, y: str, cell: Callable[[Row], Cell]) -> Cells:
    return {(row[x], row[y]): cell({str(k): v for k, v in row.items()}) for row in rows.to_dict("records")}


def _side(result: Result, part: pd.DataFrame, axis: str) -> Side:
    values = list(dict.fromkeys(part[axis]))
    ordered = sorted(values) if all(isinstance(v, int | float) for v in values) else values
    return Side(frames.label(axis, frames.axis_titles(result, part)), ordered, frames.INFINITE.get(axis, "∞"))


def _norm(values: pd.Series) -> Normalize:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return Normalize(0, 1)
    low, high = float(finite.min()), float(finite.max())
    if high - low <= SAME * abs(high):
        return Normalize(min(0.0, low), max(0.0, high) or 1.0)
    if low > 0 and high > 10 * low:
        return LogNorm(low, high)
    return Normalize(min(low, 0.0) if low < 0.3 * high else low, high)


def draw(
    maps: list[tuple[str, Cells]],
    x: Side,
    y: Side,
    title: str,
    keys: list[Patch],
    paper: Paper,
    log: bool = False,
    marks: Marks = MappingProxyType({}),
) -> Figure:
    """Draw maps with their titles, as many side by side as two columns of the paper hold; axes have titles at the edges."""
    fine = is_fine(x, y)
    em, words = paper.em, [x.words, y.words]
    words[0] = [word.replace(", ", ",\n") for word in words[0]]
    lines = max(word.count("\n") for word in words[0])
    room = max(paper.width_of(w, 1) for w in words[1]) + 2 * em
    cell = max(3.3 * em, *(paper.width_of(w, 1) + 0.4 * em for w in words[0]))
    map_width = SIDE + room if fine else max(cell * len(x.values), LEAST * em) + room
    rows = ceil(len(maps) / max(1, int(paper.full / map_width)))
    columns = ceil(len(maps) / rows)
    width = columns * map_width if fine else min(paper.full, columns * max(paper.width / 1.6, map_width))
    width = max(paper.width, min(paper.full, map_width)) if columns == 1 and not fine else width
    height = SIDE if fine else max(2.6 * em, min(ROW, TALL / len(y.values))) * len(y.values)
    height += 1.2 * em * lines
    with sheet(paper, title, len(maps), columns, height=height, width=width, keys=keys) as (figure, axes):
        for i, (ax, (name, cells)) in enumerate(zip(axes, maps, strict=True)):
            ax.set(xlim=(-0.5, len(x.values) - 0.5), ylim=(-0.5, len(y.values) - 0.5))
            for axis, labels in zip((ax.xaxis, ax.yaxis), words, strict=True):
                step = ceil(len(labels) / LINES) if fine else 1
                axis.set_ticks(range(0, len(labels), step), labels[::step])
            ax.set_title("\n".join(filter(None, [name, f"↑ {y.title}" if i % columns == 0 else ""])))
            ax.set_xlabel(x.title if i + columns >= len(maps) else "")
            ax.grid(False)
            ax.spines[:].set_visible(False)
            ax.tick_params(length=0)
            _fill(ax, cells, x, y, fine)
            if fine or min(len(x.values), len(y.values)) >= LINES:
                _draw_levels(ax, cells, x, y, log, paper.size - 2 if fine else None)
            _draw_marks(ax, x, y, marks, paper)
    for ax, (_, cells) in zip(axes, maps, strict=True):
        if not fine:
            _write(ax, cells, x, y, paper)
        for text in [text for text in ax.texts if fine and text.get_text() not in marks]:
            box, frame = text.get_window_extent(), ax.bbox
            if not (frame.x0 < box.x0 and box.x1 < frame.x1 and frame.y0 < box.y0 and box.y1 < frame.y1):
                text.remove()  # the value of a line, cut by the frame
    return figure


def is_fine(x: Side, y: Side) -> bool:
    """Return whether a map over two axes is drawn as an image."""
    numbers = all(isinstance(v, int | float) for v in (*x.values, *y.values))
    return numbers and max(len(x.values), len(y.values)) > FINE


def _fill(ax: Axes, cells: Cells, x: Side, y: Side, fine: bool) -> None:
    """Colour the cells: as one image, or each as a rectangle with its tip."""
    image = np.ones((len(y.values), len(x.values), 3))
    across, up = x.words, y.words
    for (a, b), cell in cells.items():
        i, j = x.values.index(a), y.values.index(b)
        image[j, i] = to_rgb(cell.colour)
        if not fine:
            patch = Rectangle((i - 0.5, j - 0.5), 1, 1, facecolor=cell.colour, edgecolor=GRID, linewidth=0.8)
            patch.set_gid(f"tip:{cell.tip}, {x.title} {across[i]}, {y.title} {up[j]}")
            ax.add_patch(patch)
    if fine:
        ax.imshow(image, origin="lower", aspect="auto", interpolation="nearest", zorder=0.5)


def _write(ax: Axes, cells: Cells, x: Side, y: Side, paper: Paper) -> None:
    """Write into each cell the first of its words that fits."""
    wide, tall = ax.bbox.width / ax.figure.dpi / len(x.values), ax.bbox.height / ax.figure.dpi / len(y.values)
    for (a, b), cell in cells.items():
        fits = (w.strip() for w in cell.words if paper.width_of(w.strip(), 1.5) < wide - 0.06
                and (w.strip().count("\n") + 1) * 1.2 * (paper.size - 1.5) / 72 < tall)  # fmt: skip
        ax.text(x.values.index(a), y.values.index(b), next(fits, ""), ha="center", va="center", fontsize=paper.size - 1.5,
                fontfamily=[paper.font, "DejaVu Sans"], parse_math=False, color=ink_on(cell.colour), linespacing=1.15,
                in_layout=False)  # fmt: skip


def _draw_levels(ax: Axes, cells: Cells, x: Side, y: Side, log: bool, size: float | None) -> None:
    """Draw lines of equal value between the cells' middles, with their values where these have a size."""
    grid = grid_of(cells, x, y)
    finite = grid[np.isfinite(grid)]
    if finite.size and np.ptp(finite) > SAME * np.abs(finite).max():
        locator = LogLocator(subs=(1.0, 2.0, 5.0)) if log else MaxNLocator(5, steps=[1, 2, 2.5, 5, 10])
        low, high = float(finite.min()), float(finite.max())
        levels = [float(v) for v in locator.tick_values(low, high) if low < v < high]
        finite_cells = [cell for cell in cells.values() if isfinite(cell.value)]
        inks = [ink_on(min(finite_cells, key=lambda cell: abs(cell.value - level)).colour) for level in levels]
        across, up = range(len(x.values)), range(len(y.values))
        lines = ax.contour(across, up, grid, levels, colors=inks, linewidths=0.6) if levels else None
        if size and lines:
            ax.clabel(lines, fmt=layout.number, fontsize=size)


def grid_of(cells: Cells, x: Side, y: Side) -> NDArray[np.float64]:
    """Return the values of a map, [up, across]; NaN where it has none."""
    return np.array([[cells[a, b].value if (a, b) in cells else np.nan for a in x.values] for b in y.values])


def _draw_marks(ax: Axes, x: Side, y: Side, marks: Marks, paper: Paper) -> None:
    """Draw a cross at each mark and its label on the side that has room."""
    for label, place in marks.items():
        column, row = (float(np.interp(value, side.values, np.arange(len(side.values))))
                    for value, side in zip(place, (x, y), strict=True))  # fmt: skip
        on_left = column > 0.7 * len(x.values)
        ax.plot([column], [row], marker="x", color=INK, markersize=paper.size * 0.6, markeredgewidth=1.2)
        ax.annotate(
            label, (column, row), (-5 if on_left else 5, 4), textcoords="offset points",
            ha="right" if on_left else "left", fontsize=paper.size - 1, color=INK,
        )  # fmt: skip
