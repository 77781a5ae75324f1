"""What every figure has in common: paper, font and size, axes and legend; and numbers as text.

matplotlib's constrained layout places the axes. Titles of upper axes stand above them, so that no text is upright. Long titles
are folded, and labels of ticks that would touch are left out, so nothing overlaps at any width and font.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from math import ceil, floor, isfinite, isinf, log10
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path
from matplotlib.ticker import Formatter, FuncFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

from pcbench.errors import UserError
from pcbench.plots.palette import GRID, INK, SOFT

WIDE = 30.0  # values whose largest is so many times the least are drawn on a logarithmic axis
NARROW = 3.0  # a ratio of the ends of a logarithmic axis, below which ticks are at even steps
DECADES = 12.0  # at most so many on one axis: what is smaller lies at its lower edge
BEYOND = 2.5  # margins between the largest number of an axis and infinity
MARGIN = 0.06  # room beyond the values at either end, of an axis' length
TICKS = 6  # at most
FEW = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)  # ticks of less than a decade, in which 1, 2 and 5 may be one or two
EVEN = 1.5  # ticks whose largest step is less than so many times the least are even
EXPONENT = re.compile(r"(?<=\))e([+-]\d+)")  # behind an interval in brackets
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
TICK = {"color": SOFT, "labelcolor": INK, "major.pad": 2, "major.size": 2.5, "major.width": 0.6}
LOOK = {
    "axes.axisbelow": True, "axes.edgecolor": SOFT, "axes.grid": True, "axes.labelcolor": INK, "axes.labelpad": 2.0,
    "axes.linewidth": 0.6, "axes.spines.right": False, "axes.spines.top": False, "axes.titlelocation": "left",
    "axes.titlepad": 4.0, "figure.constrained_layout.h_pad": 0.04, "figure.constrained_layout.hspace": 0.0,
    "figure.constrained_layout.w_pad": 0.02, "figure.constrained_layout.wspace": 0.02,
    "grid.color": GRID, "grid.linewidth": 0.6, "legend.borderaxespad": 0.2, "legend.borderpad": 0.0,
    "legend.columnspacing": 1.0, "legend.frameon": False, "legend.handlelength": 2.4, "legend.handletextpad": 0.4,
    "legend.labelspacing": 0.3, "text.color": INK, "text.parse_math": False,  # a text is a text, never mathematics
    "text.hinting": "none",  # a text is equally wide at every resolution
    **{f"{axis}tick.{key}": value for axis in "xy" for key, value in TICK.items()},
}  # fmt: skip


class Paper(NamedTuple):
    """Size and font of a figure, for a column of a page."""

    width: float = 3.75  # inches, of one column; maps of many observers take two
    size: float = 9.0  # points, of text
    font: str = "DejaVu Sans"  # family; letters that it lacks, and all where it is not installed, are of DejaVu Sans
    text: float | None = None  # inches, of the whole text; None: two columns

    @property
    def full(self) -> float:
        """Return the width of the whole text in inches."""
        return 2 * self.width if self.text is None else self.text

    @property
    def em(self) -> float:
        """Return the height of a letter in inches."""
        return self.size / 72

    def fit_width(self, width: float) -> float:
        """Return the width of a figure that needs so many inches: one column or the whole text, if its width is known."""
        if self.text is None:
            return width
        return self.width if width <= self.width + 1e-9 else self.text

    def validate(self) -> "Paper":
        """Return the paper; raise UserError for a width or a size on which nothing can be read."""
        if not 2.0 <= self.width <= 20.0:
            raise UserError(f"--width: got {self.width:g}, expected 2 to 20 inches; use a value in this range.")
        if not 4.0 <= self.size <= 24.0:
            raise UserError(f"--size: got {self.size:g}, expected 4 to 24 points; use a value in this range.")
        return self

    def width_of(self, text: str, smaller: float = 0.0) -> float:
        """Return the width of a text in inches, in letters `smaller` by so many points; of several lines, the widest."""
        return max(_line_width(line, self.size - smaller, self.font) for line in text.split("\n"))

    def wrap(self, text: str, wide: float) -> str:
        """Return a text in lines at most so many inches wide; neither a word nor a unit in brackets is cut."""
        lines = [""]
        for word in re.sub(r"\[.*?\]", lambda unit: unit.group().replace(" ", "\u00a0"), text).split(" "):
            longer = f"{lines[-1]} {word}".lstrip(" ")
            if lines[-1] and self.width_of(longer) > wide:
                lines.append(word)
            else:
                lines[-1] = longer
        return "\n".join(lines)

    def rc_params(self) -> mpl.RcParams:
        """Return the settings of matplotlib for all figures on this paper."""
        sizes = {"font.size": self.size, "axes.titlesize": self.size, "axes.labelsize": self.size,
                 "legend.fontsize": self.size, "legend.title_fontsize": self.size,
                 "xtick.labelsize": self.size - 1, "ytick.labelsize": self.size - 1}  # fmt: skip
        return mpl.RcParams({**LOOK, **sizes, "font.family": [self.font, "DejaVu Sans"]})


PAPER = Paper()
POINTS_PER_INCH = 72.27  # of TeX
TIMES = "STIXGeneral"  # looks like Times; matplotlib installs it
JOURNALS = {  # IEEEtran; elsarticle with its option 5p; and with 1p, which fits 3p and manuscripts too
    name: Paper(column / POINTS_PER_INCH, 8.0, TIMES, text / POINTS_PER_INCH)
    for name, column, text in (("ieee", 252, 516), ("elsevier", 252, 522), ("elsevier-1p", 384, 384))
}


@lru_cache(4096)
def _line_width(line: str, size: float, font: str) -> float:
    family = FontProperties(family=[font, "DejaVu Sans"], size=size)
    return text_to_path.get_text_width_height_descent(line, family, ismath=False)[0] / 72


@contextmanager
def sheet(
    paper: Paper,
    title: str,
    panels: int = 1,
    columns: int = 1,
    *,
    height: float = 1.55,
    width: float | None = None,
    keys: Sequence[Artist] = (),
    sharex: bool = False,
) -> Iterator[tuple[Figure, list[Axes]]]:
    """Yield a figure with its axes, row by row, to draw in; at the end they get a legend and their places.

    `height` [inches] is that of each of the axes, `width` that of the figure (None: a column of the paper). The legend has
    every artist with a label, and the `keys`.
    """
    with mpl.rc_context(paper.rc_params()):
        figure = Figure(layout="constrained")
        grid = figure.subplots(ceil(panels / columns), columns, squeeze=False, sharex=sharex)
        for ax in grid.flat[panels:]:
            ax.remove()
        yield figure, list(grid.flat[:panels])
        _lay_out(figure, grid, title, height, paper.fit_width(width or paper.width), keys, paper)


def _lay_out(
    figure: Figure,
    grid: NDArray[np.object_],
    title: str,
    height: float,
    width: float,
    keys: Sequence[Artist],
    paper: Paper,
) -> None:
    """Add the legend under the title, and choose the figure's height so that axes have theirs."""
    axes = figure.axes
    handles = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    handles |= {str(key.get_label()): key for key in keys}
    columns = _legend_columns([paper.width_of(label) for label in handles], width, paper)
    title = paper.wrap(title, width - paper.em)
    legend = figure.legend(
        handles.values(), handles.keys(), ncols=columns, title=title, alignment="left", loc="outside upper left"
    )
    legend.get_title().set_color(SOFT)
    lines = (title.count("\n") + 1 if title else 0) + ceil(len(handles) / columns)
    ems = 1.35 * lines + 0.5
    room = width / grid.shape[1] - 3 * paper.em
    for row in grid:
        row = [ax for ax in row if ax in axes]
        for ax in row:
            ax.set_title("\n".join(paper.wrap(part, room) for part in ax.get_title("left").split("\n")))
            ax.set_xlabel(paper.wrap(ax.get_xlabel(), room))
        above, below = ([text.count("\n") + 1 if text else 0 for text in texts]
                        for texts in zip(*((ax.get_title("left"), ax.get_xlabel()) for ax in row), strict=True))  # fmt: skip
        ems += 1.35 * max(above) + 1.35 * max(below) + (1.9 if max(below) else 0.6)
    figure.set_size_inches(width, ems * paper.em + height * len(grid))
    figure.draw_without_rendering()
    for ax in axes:
        _keep_inside(ax)
        _thin_out(ax, "x")
        _thin_out(ax, "y")
    figure.set_layout_engine("none")  # laid out once, for all files


def _legend_columns(widths: list[float], width: float, paper: Paper) -> int:
    """Return how many columns of keys with labels of these widths fit in a row."""
    for columns in range(len(widths), 1, -1):
        parts = np.array_split(widths, columns)
        if sum(part.max() + 3.8 * paper.em for part in parts) <= width:
            return columns
    return 1


def _keep_inside(ax: Axes) -> None:
    """Move the label of the x axis into the figure, which it leaves if it is longer than its axes."""
    label = ax.xaxis.label
    box = label.get_window_extent()
    gap = 0.05 * ax.figure.dpi
    shift = max(gap - box.x0, 0.0) - max(box.x1 + gap - ax.figure.bbox.width, 0.0)
    label.set_x(label.get_position()[0] + shift / ax.bbox.width)


def _thin_out(ax: Axes, side: str) -> None:
    """Leave out labels of an axis, x or y, that would touch: keep every n-th, or those with room if ticks are uneven."""
    axis: Axis = getattr(ax, f"{side}axis")
    low, high = sorted(axis.get_view_interval())
    ticks = [t for t in axis.get_major_ticks() if t.label1.get_visible() and low <= t.get_loc() <= high]
    boxes = [t.label1.get_window_extent() for t in ticks if t.label1.get_text()]
    if len(boxes) < 2:
        return
    ends = [(getattr(box, f"{side}0"), getattr(box, f"{side}1")) for box in boxes]
    gap = (0.3 if side == "x" else 0.0) * float(axis.label.get_fontsize()) * ax.figure.dpi / 72
    visible = [0]
    for i in range(1, len(ends)):
        if _has_gap(ends[visible[-1]], ends[i], gap):
            visible.append(i)
    steps = np.abs(np.diff([sum(end) / 2 for end in ends]))
    if steps.max() < EVEN * steps.min():
        subsets = (list(range(0, len(ends), n)) for n in range(1, len(ends) + 1))
        visible = next(part for part in subsets if all(_has_gap(ends[i], ends[j], gap) for i, j in pairwise(part)))
    if len(visible) < len(ends):
        labels = [t.label1.get_text() if i in visible else "" for i, t in enumerate(ticks)]
        axis.set_ticks([t.get_loc() for t in ticks], labels)


def _has_gap(a: tuple[float, float], b: tuple[float, float], gap: float) -> bool:
    """Return whether two intervals are more than a gap apart."""
    return a[1] + gap < b[0] or b[1] + gap < a[0]


def is_wide(values: ArrayLike) -> bool:
    """Return whether values are drawn on a logarithmic axis: all positive, over more than a decade and a half."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return bool(len(finite) and finite.min() > 0 and finite.max() > WIDE * finite.min())


def is_positive(values: ArrayLike) -> bool:
    """Return whether values, some of which may not be finite, can be drawn on a logarithmic axis."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return bool(len(finite) and finite.min() > 0)


def set_range(ax: Axes, side: str, values: ArrayLike, log: bool | None = None, margin: float = MARGIN) -> None:
    """Let an axis, x or y, show all finite `values` with some room; `log` None: logarithmic if `is_wide`."""
    finite = np.asarray(values, float).ravel()
    log = is_wide(finite) if log is None else log
    finite = finite[np.isfinite(finite) & ((finite > 0) | (not log))]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    if log and len(finite):
        low = max(low, high / 10**DECADES)
        room = 10 ** max(margin * log10(high / low), 0.03)
        set_limits(ax, side, low / room, high * room, log=True)
    else:
        room = margin * (high - low) or 0.5 * abs(high) or 1.0
        set_limits(ax, side, low - room if low < 0 or low > 2 * room else min(0.0, low), high + room)


def set_limits(ax: Axes, side: str, low: float, high: float, log: bool = False) -> None:
    """Let an axis, x or y, go from `low` to `high`, with few ticks and the numbers of `number`."""
    ax.set(**{f"{side}scale": "log" if log else "linear", f"{side}lim": (low, high)})
    axis = getattr(ax, f"{side}axis")
    if log:
        steps = (1.0,) if log10(high / low) >= 2 else (1.0, 2.0, 5.0) if high > 10 * low else FEW
        even = MaxNLocator(TICKS - 1, steps=[1, 2, 2.5, 5, 10])
        axis.set_major_locator(even if high < NARROW * low else LogLocator(subs=steps, numticks=TICKS))
        axis.set_major_formatter(FuncFormatter(lambda value, _: number(value)))
    else:
        axis.set_major_locator(MaxNLocator(TICKS - 1, steps=[1, 2, 2.5, 5, 10]))
        axis.set_major_formatter(EqualDigits())
    axis.set_minor_locator(NullLocator())


def ends_in_infinity(values: Sequence[Any]) -> bool:
    """Return whether values are numbers over more than a decade and a half, and infinity."""
    numbers = all(isinstance(v, int | float) and v == v and v > 0 for v in values)
    return numbers and sum(isinf(v) for v in values) == 1 and is_wide(values)


def set_values(ax: Axes, side: str, values: Sequence[Any], infinite: str = "∞") -> Callable[[Any], float]:
    """Give an axis, x or y, a tick at each value of a study's axis; return a function from a value to its place.

    Words, and what has no order, are spaced evenly. Infinity, which is called `infinite`, lies beyond the numbers of a wide
    axis, which then has ticks at powers of ten.
    """
    words = [word(value, infinite).replace(", ", ",\n") for value in values]
    if ends_in_infinity(values):
        numbers = sorted(float(v) for v in values if isfinite(v))
        step = 10 ** (MARGIN * log10(numbers[-1] / numbers[0]))
        beyond = numbers[-1] * step**BEYOND
        set_limits(ax, side, numbers[0] / step, beyond * step, log=True)
        tens = [10.0**n for n in range(ceil(log10(numbers[0]) - 1e-9), floor(log10(numbers[-1]) + 1e-9) + 1)]
        getattr(ax, f"set_{side}ticks")([*tens, beyond], [*map(number, tens), infinite])
        return lambda value: float(value) if isfinite(value) else beyond
    if any(isinstance(v, str) or v is None or not isfinite(v) for v in values):
        places = {word(value): float(i) for i, value in enumerate(values)}
        set_limits(ax, side, -0.5, len(values) - 0.5)
        getattr(ax, f"set_{side}ticks")(range(len(values)), words)
        return lambda value: places[word(value)]
    numbers = [float(v) for v in values]
    low, high, log = min(numbers), max(numbers), is_wide(numbers)
    room = MARGIN * (log10(high / low) if log else high - low) or 0.5
    set_limits(ax, side, *((low / 10**room, high * 10**room) if log else (low - room, high + room)), log)
    getattr(ax, f"set_{side}ticks")(numbers, words)
    return float


class EqualDigits(Formatter):
    """Ticks with equally many digits after the point, except for very large and small ones."""

    def __call__(self, value: float, pos: int | None = None) -> str:
        """Return one number."""
        return number(value)

    def format_ticks(self, values: Sequence[float]) -> list[str]:
        """Return the numbers of all ticks of an axis."""
        largest = max(map(abs, values), default=0.0)
        if largest and not 1e-3 <= largest < 1e5:
            return [number(v) for v in values]
        digits = max((len(f"{v:.6g}".partition(".")[2]) for v in values if abs(v) > 1e-9 * largest), default=0)
        return ["0" if abs(v) <= 1e-9 * largest else f"{v:.{digits}f}" for v in values]


def word(value: object, infinite: str = "∞") -> str:
    """Return a value of a study's axis as text; "own" if it is the scenario's own."""
    if value is None or value != value:
        return "own"
    if isinstance(value, float) and isinf(value):
        return infinite if value > 0 else "-∞"
    return number(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def number(value: float) -> str:
    """Return a number with four digits, in few letters; very large and small ones as powers of ten."""
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


def with_powers(text: str) -> str:
    """Return the text of an interval, "(1.03 ± 0.13)e-05", with a power of ten as `number` writes it."""
    return EXPONENT.sub(lambda found: f"·10{str(int(found[1])).translate(SUPERSCRIPT)}", text)


def short(value: float) -> str:
    """Return a number with two or three digits, for a cell of a map."""
    return number(float(f"{value:.2g}" if abs(value) < 10 else f"{value:.3g}")) if isfinite(value) else "-"
