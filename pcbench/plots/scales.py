"""Axes of pictures: from where to where, linear or logarithmic, ticks with their words; all known before anything is drawn."""

from collections.abc import Sequence
from math import ceil, floor, inf, isfinite, log10
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import MaxNLocator

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
