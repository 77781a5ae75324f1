"""What every picture has in common: paper, font and size, where panels and keys stand, and how it becomes a file.

A picture is laid out in inches before anything is drawn: ticks are known (`scales`), words are measured, margins follow. So
nothing is cut off or overlaps, at any width and font, and no picture has to be drawn twice. Axes have their titles above,
upright text needs no turned head.

What a picture is drawn on: a column's width, font and size, and how much room words take there.

Axes of pictures: from where to where, linear or logarithmic, ticks with their words; all known before anything is drawn.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from math import ceil, floor, inf, isfinite, log10
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont
from matplotlib.ft2font import FT2Font
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from pcbench.errors import UserError
from pcbench.plots.palette import GRID, INK, SOFT, Style


class Paper(NamedTuple):
    """What a picture is made for: a column of a page."""

    width: float = 3.75  # inches, of one column; maps of many observers take two
    size: float = 9.0  # points, of text
    font: str = "DejaVu Sans"  # family; where it is not installed, its metrics are guessed by DejaVu Sans

    @property
    def em(self) -> float:
        """Return the height of a letter in inches."""
        return self.size / 72

    def checked(self) -> "Paper":
        """Return the paper; raise UserError for a width or a size on which nothing can be read."""
        if not 2.0 <= self.width <= 20.0:
            raise UserError(f"--width: got {self.width:g}, expected inches of a column, 2 to 20; give one.")
        if not 4.0 <= self.size <= 24.0:
            raise UserError(f"--size: got {self.size:g}, expected points of text, 4 to 24; give one.")
        return self


PAPER = Paper()


@lru_cache(4096)
def width_of(text: str, size: float, font: str = PAPER.font) -> float:
    """Return how wide a text is in inches; of several lines, the widest."""
    face = _face(font)
    face.set_size(size, 72)
    widest = 0.0
    for line in text.split("\n"):
        face.set_text(line, 0.0)
        widest = max(widest, face.get_width_height()[0] / 64)
    return widest / 72


@lru_cache(16)
def _face(font: str) -> FT2Font:
    return FT2Font(findfont(FontProperties(family=[font, "DejaVu Sans"])))


@contextmanager
def drawn_on(paper: Paper) -> Iterator[None]:
    """Let what is drawn within have the paper's font and size, and its text be text, never mathematics."""
    with mpl.rc_context(
        {"font.family": [paper.font, "DejaVu Sans"], "font.size": paper.size, "text.parse_math": False}
    ):
        yield


def folded(text: str, wide: float, size: float, font: str) -> list[str]:
    """Return a text in lines that are at most so many inches wide; a word is never cut, nor a unit in brackets."""
    out: list[str] = []
    text = re.sub(r"\[.*?\]", lambda unit: unit.group().replace(" ", "\u00a0"), text)
    for line in text.split("\n"):
        words = line.split(" ")
        out.append(words[0])
        for word in words[1:]:
            longer = f"{out[-1]} {word}"
            if width_of(longer, size, font) <= wide:
                out[-1] = longer
            else:
                out.append(word)
    return out


WIDE = 30.0  # values whose largest is so many times the least are drawn on a logarithmic axis
DECADES = 12.0  # at most so many on one axis: what is smaller lies at its lower edge
MOST = 6  # ticks
SAME = 1e-3  # a map whose values differ by a smaller part is of one colour, and has no lines
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Scale(NamedTuple):
    """One axis."""

    low: float
    high: float
    ticks: tuple[float, ...]
    words: tuple[str, ...]
    log: bool = False

    def parts(self) -> list[float]:
        """Return where the ticks stand, as parts of the axis' length."""
        if self.log:
            return [log10(t / self.low) / log10(self.high / self.low) for t in self.ticks]
        return [(t - self.low) / (self.high - self.low) for t in self.ticks]


def is_wide(values: Any) -> bool:
    """Say whether values are drawn on a logarithmic axis: all positive, over more than a decade and a half."""
    found = np.asarray(values, float)
    found = found[np.isfinite(found)]
    return bool(len(found) and found.min() > 0 and found.max() > WIDE * found.min())


def of(values: Any, log: bool = False, margin: float = 0.06) -> Scale:
    """Return the axis that shows all finite `values`, with some room at both ends."""
    found = np.asarray(values, float).ravel()
    found = found[np.isfinite(found) & ((found > 0) | (not log))]
    if not len(found):
        return linear(0.0, 1.0)
    low, high = float(found.min()), float(found.max())
    if log:
        return logarithmic(max(low, high / 10**DECADES), high, margin)
    room = margin * (high - low) if high > low else 0.5 * abs(high) or 1.0
    return linear(low - room if low < 0 or low > 2 * room else min(0.0, low), high + room)


def linear(low: float, high: float) -> Scale:
    """Return a linear axis with these ends."""
    ticks = [float(v) for v in MaxNLocator(MOST - 1, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)]
    near = 1e-9 * (high - low)
    ticks = [0.0 if abs(v) < near else v for v in ticks if low - near <= v <= high + near]
    return Scale(low, high, tuple(ticks), alike(ticks))


def logarithmic(low: float, high: float, margin: float = 0.06) -> Scale:
    """Return a logarithmic axis from `low` to `high`, both positive, and some room beyond."""
    room = max(margin * log10(high / low), 0.03)
    a, b = log10(low) - room, log10(high) + room
    whole = range(ceil(a), floor(b) + 1)
    if len(whole) >= 3:
        step = ceil(len(whole) / MOST)
        ticks = [10.0**k for k in whole if k % step == 0]
    else:
        steps = (1, 2, 5) if b - a > 0.5 else (1, 1.5, 2, 3, 4, 5, 6, 8)
        ticks = [m * 10.0**k for k in range(floor(a), ceil(b) + 1) for m in steps if a <= log10(m * 10.0**k) <= b]
        ticks = ticks[:: ceil(len(ticks) / MOST)] if ticks else [low]
    return Scale(10**a, 10**b, tuple(ticks), tuple(map(number, ticks)), log=True)


def at(values: Sequence[Any]) -> Scale:
    """Return the axis of a study's axis: a tick at each of its values; words, and what has no order, stand evenly."""
    if any(isinstance(v, str) or v is None or not isfinite(v) for v in values):
        return Scale(-0.5, len(values) - 0.5, tuple(range(len(values))), tuple(map(word, values)))
    found = sorted(float(v) for v in values)
    log = is_wide(found)
    room = 0.06 * (log10(found[-1] / found[0]) if log else found[-1] - found[0]) or 0.5
    ends = (found[0] / 10**room, found[-1] * 10**room) if log else (found[0] - room, found[-1] + room)
    return Scale(*ends, tuple(found), tuple(map(number, found)), log)


def places(scale: Scale, values: Sequence[Any], every: Sequence[Any]) -> list[float]:
    """Return where values stand on an axis made by `at(every)`."""
    if scale.ticks == tuple(range(len(every))) and scale.words == tuple(map(word, every)):
        return [float(list(map(word, every)).index(word(v))) for v in values]
    return [float(v) for v in values]


def word(value: Any) -> str:
    """Return a value of a study's axis as a picture says it; "own" where it is the scenario's own."""
    if value is None or value != value:
        return "own"
    if value in (inf, -inf):
        return "∞" if value > 0 else "-∞"
    return number(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def number(value: float) -> str:
    """Return a number in as few letters as four digits take; very large and small ones as powers of ten."""
    if not isfinite(value):
        return "-"
    if value == 0:
        return "0"
    power = floor(log10(abs(value)) + 1e-12)
    if -4 <= power < 5:
        return f"{value:.4g}" if power < 4 else f"{value:.0f}"
    factor = f"{value / 10.0**power:.3g}"
    ten = f"10{str(power).translate(SUPERSCRIPT)}"
    return ten if factor == "1" else f"-{ten}" if factor == "-1" else f"{factor}·{ten}"


def short(value: float) -> str:
    """Return a number with two or three digits, for a cell of a map."""
    return number(float(f"{value:.2g}" if abs(value) < 10 else f"{value:.3g}")) if isfinite(value) else "-"


def alike(values: Sequence[float]) -> tuple[str, ...]:
    """Return numbers with equally many digits behind the point, where they are of ordinary size."""
    largest = max(map(abs, values), default=0.0)
    if largest and not 1e-3 <= largest < 1e5:
        return tuple(map(number, values))
    digits = max((len(f"{v:.6g}".partition(".")[2]) for v in values), default=0)
    return tuple("0" if v == 0 else f"{v:.{digits}f}" for v in values)


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
