"""Where the best observer along an axis of numbers changes: the value at which two errors are equal, with its 95 % interval.

Between two values of the axis, the logarithm of the ratio of two errors on the same runs is taken to be linear in the logarithm
of the value. The interval is that in which the 95 % interval of the ratio contains 1. A change that is not significant on both
sides is not a crossing.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.dataset.result import Result
from pcbench.plots import frames
from pcbench.plots.paired_ratios import ratios_to

Floats = NDArray[np.float64]


class Crossing(NamedTuple):
    """Two observers of which one is better below a value of the axis, the other above."""

    below: str
    above: str
    value: float
    low: float
    high: float


def crossing(
    result: Result,
    axis: str,
    below: str,
    above: str,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, object] | None = None,
) -> Crossing | None:
    """Return where `above` begins to be better than `below`, with an interval; None if they do not cross significantly."""
    stats = frames.rows(result, scenario, signal, metric)
    part = frames.fix_axes(stats, [axis], at)
    cells = part[part.observer == below].sort_values(axis, kind="stable")
    value = cells[axis].to_numpy(float)
    ends = []
    for cell in cells.cell:
        ratios = ratios_to(result, str(part.scenario.iloc[0]), str(part.signal.iloc[0]), metric, int(cell), above)
        ends.append(ratios.loc[below, ["ratio", "ci_low", "ci_high"]].to_numpy(float))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, low, high = np.log(np.array(ends)).T
        log_value = np.log(value)
    points = [_zero(log_value, line) for line in (mean, high, low)]
    return None if None in points else Crossing(below, above, *np.exp(np.array(points, float)))


def _zero(log_value: Floats, line: Floats) -> float | None:
    """Return the last place at which a line goes from below 0 to above; None if it does not, or on its way to infinity."""
    up = np.flatnonzero((line[:-1] < 0) & (line[1:] > 0) & np.isfinite(log_value[1:]))
    if not len(up):
        return None
    i = up[-1]
    return float(log_value[i] - line[i] * (log_value[i + 1] - log_value[i]) / (line[i + 1] - line[i]))


def changes(
    result: Result,
    axis: str,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, object] | None = None,
) -> list[Crossing]:
    """Return every crossing of the best observer with the next best along an axis."""
    part = frames.fix_axes(frames.rows(result, scenario, signal, metric), [axis], at)
    if (part.method == "exact").any():
        return []
    rows = part[part["mean"].notna()].sort_values([axis, "mean"], kind="stable")
    best = rows.drop_duplicates(axis).observer.astype(str).to_list()
    pairs = dict.fromkeys((a, b) for a, b in pairwise(best) if a != b)
    return [
        c
        for pair in pairs
        if (c := crossing(result, axis, *pair, scenario=scenario, signal=signal, metric=metric, at=at))
    ]
