"""What suffices, in a sentence beside a curve: up to which value of its axis each observer's error surely stays below a limit.

From the values that were run; `pcbench find-limit` finds values between them.
"""

from math import isfinite

import pandas as pd

from pcbench.plots import scales
from pcbench.report.captions import number
from pcbench.statistics import limit_search
from pcbench.statistics.limit_search import Answer

TIMES = 2.0  # the least error of the axis, that is the limit where none is given


def said(part: pd.DataFrame, axis: str, unit: str, threshold: float | None) -> str:
    """Return what suffices, from the rows of stats along an axis; empty where the axis is no numbers, or no error is finite.

    `below` is the limit, in the unit of the rows; None: TIMES their least mean.
    """
    if not all(isinstance(v, int | float) and isfinite(v) for v in part[axis]):
        return ""
    least = part["mean"].min()
    limit = TIMES * least if threshold is None else threshold
    if not limit > 0:
        return ""
    found = limit_search.points(part, axis, limit)
    each = "; ".join(f"{observer} {_words(limit_search.answer(points))}" for observer, points in found.items())
    which = f"{number(limit)} {unit}".strip() + (", twice the least" if threshold is None else "")
    return f"Surely below {which}: {each}."


def _words(a: Answer) -> str:
    """An answer in a few words."""
    if a.largest is None or a.kind != "up to":
        return {
            "every value": "everywhere",
            "no value": "nowhere",
            "undecided": "not sure anywhere",
        }.get(a.kind, "has no number")
    end = f"up to {scales.word(a.largest.value)}"
    beyond = f", not at {scales.word(a.exceeds.value)}" if a.exceeds else ", beyond not sure"
    odd = f", but not at {scales.word(a.fails_below.value)}" if a.fails_below else ""
    return end + beyond + odd
