"""What every picture has in common: paper, font and size, where panels and keys stand, and how it becomes a file.

A picture is laid out in inches before anything is drawn: ticks are known (`scales`), words are measured, margins follow. So
nothing is cut off or overlaps, at any width and font, and no picture has to be drawn twice. Axes have their titles above,
upright text needs no turned head.
"""

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from pcbench.plots.canvas import Paper, drawn_on, folded, width_of
from pcbench.plots.palette import GRID, INK, SOFT, Style
from pcbench.plots.scales import Scale


class Key(NamedTuple):
    """One entry of a legend."""

    label: str
    style: Style
    kind: str = "line"  # or patch
    width: float = 1.6  # points, of a line


class Panel(NamedTuple):
    """One pair of axes."""

    x: Scale
    y: Scale
    x_title: str = ""  # empty: another panel below has it, with the ticks' words
    y_title: str = ""
    height: float = 1.55  # inches
    grid: bool = True


def sheet(
    paper: Paper,
    title: str,
    panels: Sequence[Panel],
    keys: Sequence[Key] = (),
    columns: int = 1,
    width: float | None = None,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with its axes, row by row, each with limits, ticks and titles; nothing is drawn in them yet."""
    em, wide = paper.em, width or paper.width
    small = paper.size - 1
    rows = [list(panels[i : i + columns]) for i in range(0, len(panels), columns)]
    left = [max(width_of(w, small, paper.font) for r in rows if i < len(r) for w in ("0", *r[i].y.words)) + 0.6 * em
            for i in range(columns)]  # fmt: skip
    ends = [_overhang(r[-1], small, paper) for r in rows]
    each = (wide - sum(left) - max(ends) - 0.1 * em - 1.2 * em * (columns - 1)) / columns
    flow = _flowing(keys, wide, paper)
    head = (1.7 * em if title else 0.2 * em) + (1.5 * em * len(flow) + 0.3 * em if flow else 0)
    rows = [[p._replace(x=_roomy(p.x, each, small, paper.font)) for p in row] for row in rows]
    under = [max(_below(p, each, paper) for p in row) for row in rows]
    above = [max(_above(p, each + left[0], paper) for p in row) for row in rows]
    tall = head + sum(above) + sum(max(p.height for p in row) for row in rows) + sum(under) + 0.1 * em
    with drawn_on(paper):
        figure = Figure(figsize=(wide, tall))
        if title:
            figure.text(
                0.02 * em / wide, 1 - 0.15 * em / tall, _fit(title, wide, paper), ha="left", va="top", color=SOFT
            )
        _legend(figure, flow, tall - (1.7 * em if title else 0.2 * em), paper)
        top, out = tall - head, []
        for row, up, down in zip(rows, above, under, strict=True):
            height = max(p.height for p in row)
            x = 0.0
            for i, panel in enumerate(row):
                x += left[i]
                box = (x / wide, (top - up - height) / tall, each / wide, height / tall)
                out.append(_dressed(figure, box, panel, x - (left[i] if i == 0 else 0.9 * left[i]), paper))
                x += each + 1.2 * em
            top -= up + height + down
    return figure, out


def _roomy(x: Scale, wide: float, size: float, font: str) -> Scale:
    """An axis whose words do not touch: lists are folded at their commas, then every so many words stand."""
    for words in (x.words, tuple(w.replace(", ", ",\n") for w in x.words)):
        if _apart(x, words, wide, size, font, 1):
            return x._replace(words=words)
    step = next((s for s in range(2, len(words)) if _apart(x, words, wide, size, font, s)), len(words))
    return x._replace(words=tuple("" if i % step else w for i, w in enumerate(words)))


def _apart(x: Scale, words: Sequence[str], wide: float, size: float, font: str, step: int) -> bool:
    """Whether every so many words stand apart under their ticks."""
    where = [wide * p for p in x.parts()][::step]
    sizes = [width_of(w, size, font) for w in words][::step]
    gap = 0.35 * size / 72
    return all(b - a > (u + v) / 2 + gap for a, b, u, v in zip(where, where[1:], sizes, sizes[1:], strict=False))


def _overhang(panel: Panel, size: float, paper: Paper) -> float:
    """How far the last word of a panel's lower axis may stand out to the right."""
    if not panel.x_title or not panel.x.words:
        return 0.0
    return width_of(panel.x.words[-1], size, paper.font) / 2


def _below(panel: Panel, wide: float, paper: Paper) -> float:
    """What stands under a panel: the ticks' words and the axis' title."""
    if not panel.x_title:
        return 0.9 * paper.em
    lines = max((w.count("\n") for w in panel.x.words), default=0)
    return (1.5 + 1.2 * lines + 1.3 * len(folded(panel.x_title, wide, paper.size, paper.font)) + 0.5) * paper.em


def _above(panel: Panel, wide: float, paper: Paper) -> float:
    return (
        (1.35 * len(folded(panel.y_title, wide, paper.size, paper.font)) + 0.2) * paper.em
        if panel.y_title
        else 0.4 * paper.em
    )


def _fit(text: str, wide: float, paper: Paper) -> str:
    """A title that fits: what is too long loses its last parts."""
    parts = text.split(", ")
    while len(parts) > 1 and width_of(", ".join(parts), paper.size, paper.font) > wide:
        parts = parts[:-1]
    return ", ".join(parts)


def _flowing(keys: Sequence[Key], wide: float, paper: Paper) -> list[list[tuple[float, Key]]]:
    """The rows of a legend: where each key begins."""
    rows: list[list[tuple[float, Key]]] = []
    x = wide
    for key in keys:
        needs = 3.0 * paper.em + width_of(key.label, paper.size, paper.font) + paper.em
        if x + needs - paper.em > wide:
            rows.append([])
            x = 0.0
        rows[-1].append((x, key))
        x += needs
    return rows


def _legend(figure: Figure, rows: list[list[tuple[float, Key]]], top: float, paper: Paper) -> None:
    em, inches = paper.em, figure.dpi_scale_trans
    for i, row in enumerate(rows):
        y = top - (1.5 * i + 0.75) * em
        for x, (label, style, kind, width) in row:
            if kind == "patch":
                box = Rectangle((x, y - 0.4 * em), 2.4 * em, 0.8 * em, transform=inches)
                box.set(facecolor=style.colour, edgecolor=SOFT, linewidth=0.4)
                figure.add_artist(box)
            else:
                mark = style.marker if kind == "points" else ""
                line = Line2D([x, x + 1.2 * em, x + 2.4 * em], [y] * 3, transform=inches, marker=mark, markersize=4.5)
                line.set(color=style.colour, linewidth=width, linestyle=style.line if width else "none", markevery=[1])
                figure.add_artist(line)
            figure.text(x + 2.8 * em, y, label, transform=inches, ha="left", va="center_baseline", color=INK)


def _dressed(figure: Figure, box: tuple[float, float, float, float], panel: Panel, x: float, paper: Paper) -> Axes:
    """Axes with limits, ticks, titles and a light grid; the upper title begins at x inches."""
    ax = figure.add_axes(box)
    ax.set_xscale("log" if panel.x.log else "linear")
    ax.set_yscale("log" if panel.y.log else "linear")
    ax.minorticks_off()
    ax.set_xticks(panel.x.ticks, panel.x.words if panel.x_title else [""] * len(panel.x.ticks))
    ax.set_yticks(panel.y.ticks, panel.y.words)
    ax.set_xlim(panel.x.low, panel.x.high)
    ax.set_ylim(panel.y.low, panel.y.high)
    ax.tick_params(length=2.5, width=0.6, pad=2, color=SOFT, labelcolor=INK, labelsize=paper.size - 1)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set(linewidth=0.6, color=SOFT)
    if panel.grid:
        ax.grid(True, color=GRID, linewidth=0.6)
        ax.set_axisbelow(True)
    tall, wide = figure.get_size_inches()[1], figure.get_size_inches()[0]
    if panel.y_title:
        text = "\n".join(folded(panel.y_title, box[2] * wide + box[0] * wide - x, paper.size, paper.font))
        figure.text(x / wide, box[1] + box[3] + 0.45 * paper.em / tall, text, ha="left", va="bottom", color=INK)
    if panel.x_title:
        text = "\n".join(folded(panel.x_title, box[2] * wide, paper.size, paper.font))
        under = 1.75 + 1.2 * max((w.count("\n") for w in panel.x.words), default=0)
        figure.text(box[0] + box[2] / 2, box[1] - under * paper.em / tall, text, ha="center", va="top", color=INK)
    return ax
