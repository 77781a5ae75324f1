"""Lag between channels of a recording, from the cross-correlation of their rates of change.

    r(t) = change of a channel's value over the interval around t, divided by its length; on a common grid
    c(L) = sum r_a(t) r_b(t + L) / root of sum r_a(t)^2 sum r_b(t + L)^2,   lag: maximum of |c| (parabola between steps)

A lag is positive if the second channel is later. Channels are compared at their timestamps, the faster one averaged over an
interval of the slower one. Two channels that measure the same motion have proportional rates. For other channels |c| is small,
and no lag is reported. The interval leaves out one of BLOCKS parts of the recording at a time (jackknife). Not claimed: a lag
between channels that measure different quantities, such as a position and a velocity. Source: Efron, Tibshirani, An
introduction to the bootstrap, 1993, chapter 11.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from pcbench.recordings.log import Floats, Ints, Log

MOST = 1 << 17  # largest number of samples per channel
BLOCKS = 10
RANGE = 10.0  # largest lag, in intervals of the slower channel
STEPS = 1 << 16  # largest number of grid points
T9 = 2.2621571627409915  # 97.5 % quantile of Student's t with BLOCKS - 1 degrees of freedom
ALIKE = 0.5  # |c| from which two channels count as similar


class Lag(NamedTuple):
    """The lag between two channels of a recording [s]."""

    first: str
    second: str
    lag: float  # positive: the second is later
    low: float  # 95 % interval
    high: float
    correlation: float  # of the rates at this lag


def lags_of(log: Log) -> list[Lag]:
    """Return the lag of each pair of channels with similar rates."""
    parts: list[list[Floats]] = [[] for _ in log.channels]
    counts = np.zeros(len(log.channels), int)
    for batch in log.measurements():
        for c in range(len(parts)):
            mask = (batch.channel == c) & np.isfinite(batch.value)
            if counts[c] < MOST and mask.any():
                parts[c].append(np.stack([batch.sampled[mask], batch.value[mask]], 1))
                counts[c] += mask.sum()
        if (counts >= MOST).all():
            break
    series = [np.concatenate(p) if p else np.zeros((0, 2)) for p in parts]
    lags = (_lag(log.channels[i], log.channels[j], series[i], series[j]) for i, j in combinations(range(len(parts)), 2))
    return [lag for lag in lags if lag is not None]


def _lag(first: str, second: str, a: Floats, b: Floats) -> Lag | None:
    """Return the lag of two channels, each in rows of timestamp and value; None if they are not similar."""
    if min(len(a), len(b)) < 4 * BLOCKS:
        return None
    a, b = (series[np.unique(series[:, 0], return_index=True)[1]] for series in (a, b))
    slow = max(float(np.median(np.diff(series[:, 0]))) for series in (a, b))
    start, end = max(a[0, 0], b[0, 0]), min(a[-1, 0], b[-1, 0])
    step = max(min(float(np.median(np.diff(series[:, 0]))) for series in (a, b)), (end - start) / STEPS)
    reach = int(RANGE * slow / step)
    grid = np.arange(start, end, step)
    if len(grid) < max(4 * reach, 4 * BLOCKS):
        return None
    ra, rb = (np.diff(np.interp(grid, series[:, 0], series[:, 1])) for series in (_smooth(a, slow), _smooth(b, slow)))
    inner = np.arange(reach, len(ra) - reach)
    shifts = np.arange(-reach, reach + 1)
    block = np.minimum((inner - inner[0]) * BLOCKS // len(inner), BLOCKS - 1)
    sums = np.zeros((BLOCKS, len(shifts), 3))
    for k, shift in enumerate(shifts):
        x, y = ra[inner], rb[inner + shift]
        for i, product in enumerate((x * y, x * x, y * y)):
            sums[:, k, i] = np.bincount(block, product, BLOCKS)
    total = sums.sum(0)
    lag, c = _peak(total, shifts)
    if not abs(c) > ALIKE:
        return None
    lags = np.array([_peak(total - block_sums, shifts)[0] for block_sums in sums])
    half = T9 * float(np.sqrt((BLOCKS - 1) / BLOCKS * np.square(lags - lags.mean()).sum()))
    if 2 * half > reach:  # an interval as long as half the range of the search determines no lag
        return None
    lag, half = float(lag * step), float(half * step)
    return Lag(first, second, lag, lag - half, lag + half, c)


def _smooth(series: Floats, slow: float) -> Floats:
    """Return a channel averaged over the interval of the slower one, so that both have the same bandwidth."""
    width = max(round(slow / float(np.median(np.diff(series[:, 0])))), 1)
    if width == 1:
        return series
    window = np.ones(width) / width
    return np.stack([np.convolve(column, window, "valid") for column in series.T], 1)


def _peak(sums: Floats, shifts: Ints) -> tuple[float, float]:
    """Return the position of the largest |correlation| in steps, and its size."""
    with np.errstate(invalid="ignore", divide="ignore"):
        c = np.nan_to_num(sums[:, 0] / np.sqrt(sums[:, 1] * sums[:, 2]))
    i = int(np.argmax(np.abs(c)))
    if not 0 < i < len(c) - 1:
        return float(shifts[i]), float(c[i])
    before, here, after = np.abs(c[i - 1 : i + 2])
    bend = before - 2 * here + after
    return float(shifts[i]) + (0.5 * (before - after) / bend if bend < 0 else 0.0), float(c[i])
