"""Check that all times of a log are of one clock: stamps and arrivals of each channel, inputs and truth.

Times of two clocks (simulated time and the time of day, a stamp of 0 before a receiver has its first fix, milliseconds read
as seconds) form groups with a gap between them. Let g be one of the three largest gaps between neighbouring times of the log,
and r the sum of all smaller gaps:

    two clocks:   g > FACTOR r   and   g > HOUR, or g > DAY if one column has times on both sides

So the limit is relative to the time that the log covers, and a log that passes lasts at most FACTOR times as long as its rows
do, or a few days. Not claimed: that clocks that differ by less are found; `pcbench info` shows their delays.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.recordings.running_stats import Spread, add, largest

FACTOR = 10.0
GAPS = 3  # the largest gaps that are looked at
HOUR, DAY, YEAR = 3600.0, 86400.0, 365.25 * 86400.0  # [s]


class Times(NamedTuple):
    """One column of times; rows count from 1."""

    name: str  # as a sentence names it
    fix: str  # how to convert it, as a sentence says it
    spread: Spread = Spread()
    least: NDArray[Any] = np.zeros((0, 2))  # [1, 2] (minus the earliest time [s], its row)
    most: NDArray[Any] = np.zeros((0, 2))  # [1, 2] (the latest time [s], its row)

    @property
    def low(self) -> float:
        """Return the earliest time [s]."""
        return self.spread.least

    @property
    def high(self) -> float:
        """Return the latest time [s]."""
        return self.spread.most


def more(times: Times, t: NDArray[Any], rows: NDArray[Any]) -> Times:
    """Return a column with some times [K] more; NaN is no time."""
    there = np.isfinite(t)
    t, rows = t[there], rows[there].astype(float)
    return times._replace(
        spread=add(times.spread, rows, t),
        least=largest(times.least, -t, rows, most=1),
        most=largest(times.most, t, rows, most=1),
    )


def require_one(where: str, columns: Sequence[Times]) -> None:
    """Raise UserError for times of two clocks; it names the row, or the columns that differ."""
    every = [c for c in columns if c.spread.many]
    ends = [np.array([c.low, c.high]) for c in every]
    times = np.unique(np.concatenate([*ends, *(c.spread.kept[:, 1] for c in every)]))
    gaps = np.diff(times)
    order = np.argsort(-gaps, kind="stable")
    for i, at in enumerate(order[:GAPS]):
        before, after = float(times[at]), float(times[at + 1])
        both = [c for c in every if c.low <= before and c.high >= after]
        if gaps[at] > max(FACTOR * gaps[order[i + 1 :]].sum(), DAY if both else HOUR):
            raise UserError(
                f"{where}: {_row(both[0], every, before, after) if both else _columns(every, before, after)}."
            )


def _row(column: Times, every: Sequence[Times], before: float, after: float) -> str:
    """What is wrong with a column that has times on both sides of a gap; most times of the log are right."""
    early = np.concatenate([c.spread.kept[:, 1] <= before for c in every])
    few = 2 * early.sum() <= len(early)
    time, row, side = (column.low, column.least[0, 1], "before") if few else (column.high, column.most[0, 1], "after")
    return (
        f"row {int(row)} has {time:.10g} s among the {column.name}, {apart(after - before)} {side} the other times of "
        "the log, so it is of another clock; remove that row or convert its time"
    )


def _columns(every: Sequence[Times], before: float, after: float) -> str:
    """What is wrong with columns of which some are before a gap and the others after it."""
    early, late = ([c for c in every if (c.high <= before) == side] for side in (True, False))
    wrong = late[0] if every[0].high <= before else early[0]
    names = [f"{c[0].name}{' and others' if len(c) > 1 else ''}" for c in (early, late)]
    return (
        f"the {names[0]} end at {before:.10g} s and the {names[1]} begin at {after:.10g} s, {apart(after - before)} apart, so "
        f"they are of two clocks or units; {wrong.fix}"
    )


def apart(seconds: float) -> str:
    """Return a length of time as a sentence says it."""
    for unit, name in ((YEAR, "years"), (DAY, "days"), (HOUR, "hours")):
        if seconds >= unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.3g} s"
