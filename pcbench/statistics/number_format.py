"""Estimates as text: a value with its interval, both to the same digit. No jax.

`0.2224 ± 0.0072` is a mean and half its 95 % interval, with two digits of the latter. If the interval is asymmetric, as for a
mean of few runs that cannot be negative, the ends are printed: `0.0047 (0.0011 .. 0.020)`.
"""

from collections.abc import Iterable
from math import floor, isfinite, isnan, log10
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

ROUNDING = 1e-11  # a smaller value is printed as 0
EXACT = 1e-6  # an interval narrower than this part of its value is not printed; the value has six digits
MARK = " *"  # after the name of an observer without a certificate
UNPROVEN = "* No certificate for"  # start of the sentence below a table
LEAN = 1.25  # ratio of the two sides above which an interval is asymmetric


def mark_uncertified(observer: str, certified: Iterable[object]) -> str:
    """Return an observer's name, with a mark if its gains have no certificate at a grid point; None and NaN are unknown."""
    return observer + MARK if any(flag in (False,) for flag in certified) else observer


def interval(row: Any) -> str:
    """Return an estimate of stats with its interval, as text."""
    return estimate(row["mean"], row["ci_low"], row["ci_high"])


def estimate(value: float, low: float, high: float, sign: str = "") -> str:
    """Return a value with its interval, as text; `sign` "+" marks positive numbers. For one run the interval is `?`."""
    if isnan(value):
        return "-"
    if abs(value) < ROUNDING:
        return "0"
    if not (isfinite(low) and isfinite(high)):
        return f"{value:{sign}.4g} ± ?"
    half, sides = (high - low) / 2, sorted((value - low, high - value))
    if half <= EXACT * abs(value):
        return f"{value:{sign}.{4 if half == 0 else 6}g}"
    if sides[1] > LEAN * sides[0]:
        return f"{value:{sign}.3g} ({low:.2g} .. {high:.2g})"
    return _format_estimate(value, half, sign)


def _format_estimate(value: float, half: float, sign: str) -> str:
    """Return a value and half its interval, to two digits of the latter."""
    half = float(f"{half:.1e}")
    digits, power = 1 - floor(log10(half)), floor(log10(max(abs(value), half)))
    if -5 < power < 6:
        value = round(value, digits)
        return f"{value:{sign}.{max(digits, 0)}f} ± {half:.{max(digits, 0)}f}"
    return f"({value / 10.0**power:{sign}.{digits + power}f} ± {half / 10.0**power:.{digits + power}f})e{power:+03d}"


def fraction(row: Any) -> str:
    """Return a fraction of runs with its interval, in per cent."""
    return f"{100 * row['mean']:.3g} % ({100 * row['ci_low']:.3g} .. {100 * row['ci_high']:.3g})"


def as_good(observers: Iterable[str], cells: int = 1, of: int = 1) -> str:
    """Return a text that these observers are not significantly worse than the best, at how many of several grid points."""
    return f"as good as the best: {', '.join(observers)}" + (f" at {cells:,} of {of:,} grid points" if of > 1 else "")


def difference(pairs: "pd.DataFrame", observer: str, best: str) -> str:
    """Return the difference of an observer to the best, with its interval; '=' if it is not distinguishable."""
    forward = pairs[(pairs.observer_a == observer) & (pairs.observer_b == best)]
    backward = pairs[(pairs.observer_a == best) & (pairs.observer_b == observer)]
    if forward.empty and backward.empty:
        return "-"
    row, sign = (forward.iloc[0], 1) if len(forward) else (backward.iloc[0], -1)
    is_tie = row.p_holm > 0.05 or row.prob_a_better == 0.5 or row.mean_diff == 0
    if row.n != 1 and is_tie:  # with one run there is no test
        return "="
    low, high = sorted((sign * row.ci_low, sign * row.ci_high))
    return estimate(sign * row.mean_diff, low, high, sign="+")
