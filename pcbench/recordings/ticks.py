"""Seconds of a log as ticks of dt: how far they are rounded, and a dt that makes that small."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcbench.recordings.log import Floats, Ints

NEVER = 2**40  # the tick of what was lost
SMALL = 0.01  # of a median interval: a rounding that hardly matters
DIVISORS = (1, 2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 64, 80, 100, 125, 200, 250, 500, 1000)


def ticks(times: Floats, start: float, dt: float) -> tuple[Ints, float]:
    """Return times [s] as ticks since the start, and the largest rounding [s]; NaN is NEVER."""
    there = np.isfinite(times)
    exact = np.where(there, times - start, 0.0) / dt
    whole = np.rint(exact)
    off = float(np.abs(exact - whole).max(initial=0.0)) * dt
    return np.where(there, whole, NEVER).astype(np.int64), off


def better(grid: NDArray[Any], dt: float, interval: float) -> float | None:
    """Return the longest dt [s] of a few that rounds the times `grid` [s] by less than SMALL of an interval; None: no need.

    Tried are the interval and dt divided by whole numbers. Where none is short enough, twice what is small: no time is rounded
    by more than half a tick.
    """
    small = SMALL * interval

    def rounded(h: float) -> float:
        return float(np.abs(grid / h - np.rint(grid / h)).max(initial=0.0)) * h

    if not interval > 0 or rounded(dt) <= small:
        return None
    tried = sorted({base / n for base in (interval, dt) for n in DIVISORS if base / n < dt * (1 - 1e-9)}, reverse=True)
    return next((h for h in tried if rounded(h) <= small), float(f"{2 * small:.1g}"))
