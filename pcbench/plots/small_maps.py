"""Small maps side by side: coloured cells with what fits into them, titles once a column and once a row, contour lines."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from pcbench.plots import layout
from pcbench.plots.layout import Key, Panel, Paper, drawn_on, sheet, width_of
from pcbench.plots.palette import INK, on

FINE = 6  # values of both axes from which on contour lines are drawn
ROW = 0.42  # inches of a cell, where there are few
TALL = 2.6  # inches of a map, where there are many
LEAST = 8  # letters' heights that a map is wide


class Cell(NamedTuple):
    """One cell of a map."""

    colour: str
    words: tuple[str, ...] = ()  # the longest first: the first that fits is written
    tip: str = ""  # what is said of it in full
    value: float = np.nan  # of which lines of equal value are drawn


class Over(NamedTuple):
    """One of the two axes of all maps."""

    title: str
    values: list[Any]


class Map(NamedTuple):
    """One map."""

    title: str
    cells: dict[tuple[Any, Any], Cell]  # by the values of both axes


def drawn(
    maps: list[Map], x: Over, y: Over, title: str, keys: list[Key], paper: Paper, log: bool, keyed: bool = False
) -> Figure:
    """Draw maps side by side, as many as two columns of the paper hold; with keys where some cell has no room for words."""
    across, up = (layout.Scale(-0.5, len(v) - 0.5, tuple(range(len(v))), tuple(map(layout.word, v))) for _, v in (x, y))
    columns, wide = _columns(len(maps), across, up, paper)
    height = max(2.6 * paper.em, min(ROW, TALL / len(y.values))) * len(y.values)
    panels = []
    for i, each in enumerate(maps):  # titles once a column and once a row
        above = [each.title, f"↑ {y.title}" if i % columns == 0 else ""]
        below = x.title if i + columns >= len(maps) else ""
        panels.append(Panel(across, up, below, "\n".join(filter(None, above)) or " ", height, grid=False))
    figure, axes = sheet(paper, title, panels, keys if keyed else [], columns, wide)
    with drawn_on(paper):
        fits = [_filled(ax, each, x, y, figure, paper, log) for ax, each in zip(axes, maps, strict=True)]
    if keys and not keyed and not all(fits):
        return drawn(maps, x, y, title, keys, paper, log, keyed=True)
    return figure


def _columns(many: int, across: layout.Scale, up: layout.Scale, paper: Paper) -> tuple[int, float]:
    """How many maps stand side by side, and how wide they are together in inches."""
    small, em = paper.size - 1, paper.em
    cell = max(3.3 * em, *(width_of(w, small, paper.font) + 0.4 * em for w in across.words))
    room = max(width_of(w, small, paper.font) for w in up.words) + 2 * em
    each = max(cell * len(across.words), LEAST * em) + room
    columns = max(1, min(many, int(2 * paper.width / each)))
    if columns == 1:
        return 1, paper.width
    return columns, min(2 * paper.width, columns * max(paper.width / 1.6, each))


def _filled(ax: Axes, each: Map, x: Over, y: Over, figure: Figure, paper: Paper, log: bool) -> bool:
    """Fill the cells of a map, and write into each what fits; say whether something fits into all."""
    box, (whole, high) = ax.get_position(), figure.get_size_inches()
    room = box.width * whole / len(x.values), box.height * high / len(y.values)
    small, every = paper.size - 1.5, True
    for (a, b), cell in each.cells.items():
        i, j = x.values.index(a), y.values.index(b)
        patch = Rectangle((i - 0.5, j - 0.5), 1, 1, facecolor=cell.colour, edgecolor="#FFFFFF", linewidth=0.8)
        patch.set_gid(f"tip:{cell.tip}, {x.title} {layout.word(a)}, {y.title} {layout.word(b)}")
        ax.add_patch(patch)
        words = next((w.strip() for w in cell.words if _goes_in(w.strip(), room, small, paper)), "")
        ax.text(i, j, words, ha="center", va="center", fontsize=small, color=on(cell.colour), linespacing=1.15)
        every &= bool(words)
    if min(len(x.values), len(y.values)) >= FINE:
        _contours(ax, each, x, y, log)
    for side in ax.spines.values():
        side.set_visible(False)
    ax.tick_params(length=0)
    return every


def _goes_in(text: str, room: tuple[float, float], size: float, paper: Paper) -> bool:
    lines = text.count("\n") + 1
    return width_of(text, size, paper.font) < room[0] - 0.06 and lines * 1.2 * size / 72 < room[1]


def _contours(ax: Axes, each: Map, x: Over, y: Over, log: bool) -> None:
    """Lines of equal value between the cells' middles."""
    grid = grid_of(each, x, y)
    if levels := levels_of(grid, log):
        ax.contour(range(len(x.values)), range(len(y.values)), grid, levels=levels, colors=INK, linewidths=0.6)


def grid_of(each: Map, x: Over, y: Over) -> NDArray[np.float64]:
    """Return the values of a map, [up, across]; NaN where it has none."""
    grid = np.full((len(y.values), len(x.values)), np.nan)
    rows, columns = ({v: i for i, v in enumerate(over.values)} for over in (y, x))
    for (a, b), cell in each.cells.items():
        grid[rows[b], columns[a]] = cell.value
    return grid


def levels_of(grid: NDArray[np.float64], log: bool) -> list[float]:
    """Return the values of which lines are drawn."""
    found = grid[np.isfinite(grid)]
    if not found.size or np.ptp(found) <= layout.SAME * np.abs(found).max():
        return []
    return [v for v in layout.of(found, log).ticks if found.min() < v < found.max()]
