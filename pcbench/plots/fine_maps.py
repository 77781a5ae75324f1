"""Maps of many cells side by side: an image each, with labelled lines of equal value and marks; no words in cells."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pcbench.plots import scales
from pcbench.plots.canvas import Paper, drawn_on, width_of
from pcbench.plots.layout import Key, Panel, sheet
from pcbench.plots.palette import INK
from pcbench.plots.small_maps import Map, Over, grid_of, levels_of

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


def _thinned(over: Over) -> scales.Scale:
    """An axis of cells with ticks at some of their values, the first and others as far apart."""
    many = len(over.values)
    kept = tuple(range(0, many, -(-many // TICKS)))
    return scales.Scale(-0.5, many - 0.5, kept, tuple(scales.word(over.values[i]) for i in kept))


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
        ax.clabel(lines, fmt=dict(zip(levels, map(scales.number, levels), strict=True)), fontsize=paper.size - 2)


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
