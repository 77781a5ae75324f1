"""Times of a recording in ticks, and a check that all times are of one clock.

Times of two clocks form groups with a gap between them. Examples are simulated time and time of day, a timestamp of 0 before a
receiver has its first fix, or milliseconds read as seconds. Let g be one of the three largest gaps between neighbouring times,
and r the sum of all smaller gaps:

    two clocks:   g > FACTOR r   and   g > HOUR, or g > DAY if one column has times on both sides

The limit is relative to the time that the rows cover: an accepted recording lasts at most FACTOR times as long as its rows, or
a few days. Not claimed: that smaller clock differences are found; `pcbench info` shows the delays.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pcbench.errors import UserError
from pcbench.recordings.log import Batch, Floats, Ints, Log, Rows
from pcbench.recordings.running_stats import RunningStats

NEVER = 2**40  # the tick of a lost sample
SMALL = 0.01  # relative to a median interval: negligible rounding
DIVISORS = (1, 2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 64, 80, 100, 125, 200, 250, 500, 1000)
FACTOR = 10.0
GAPS = 3  # number of the largest gaps that are examined
HOUR, DAY, YEAR = 3600.0, 86400.0, 365.25 * 86400.0  # [s]


class Clock(NamedTuple):
    """Conversion of a log's seconds to ticks."""

    start: float  # [s] of the log's clock, tick 0
    dt: float  # [s]

    def ticks(self, times: Floats) -> Ints:
        """Return times [s] as ticks; NaN is NEVER."""
        exists = np.isfinite(times)
        return np.where(exists, np.rint(np.where(exists, times - self.start, 0.0) / self.dt), NEVER).astype(np.int64)


def rounding(times: Floats, dt: float) -> float:
    """Return the largest rounding error [s] of times since tick 0 [s] in ticks of dt [s]."""
    return float(np.abs(times / dt - np.rint(times / dt)).max(initial=0.0)) * dt


def better_dt(times: Floats, dt: float, interval: float) -> float | None:
    """Return the longest of a few dt [s] that rounds times [s] by less than SMALL of an interval [s]; None: no need.

    Candidates are the interval and dt divided by whole numbers. If none is short enough, the result is twice the allowed
    rounding, as no time is rounded by more than half a tick.
    """
    small = SMALL * interval
    if not interval > 0 or rounding(times, dt) <= small:
        return None
    steps = sorted({base / n for base in (interval, dt) for n in DIVISORS if base / n < dt * (1 - 1e-9)}, reverse=True)
    return next((h for h in steps if rounding(times, h) <= small), float(f"{2 * small:.1g}"))


def require_sound(log: Log, batch: Batch) -> None:
    """Raise UserError with the first invalid row of a batch.

    A row is invalid without a number or a time, if it arrived before it was sampled, or if its stated noise is not positive.
    """
    above_0 = np.isfinite(batch.std) & (batch.std > 0) | np.isnan(batch.std) if len(batch.std) else np.array([True])
    for is_invalid, got, expected in (
        (~np.isfinite(batch.sampled), "a sample without a time", "the second at which it was taken in 'sampled'"),
        (~np.isfinite(batch.value) & ~np.isnan(batch.arrived), "the value {value}", "a finite number"),
        (batch.arrived < batch.sampled, "a sample that arrived {early:.6g} s before it was sampled", "no such row"),
        (~above_0, "a standard deviation or variance that is empty, 0, below 0 or infinite", "a number above 0"),
    ):
        if is_invalid.any():
            i = int(np.argmax(is_invalid))
            early = batch.sampled[i] - batch.arrived[i]
            place = f"{log.name}: row {batch.row[i]} of channel {log.channels[batch.channel[i]]}"
            if early > HOUR:
                raise UserError(
                    f"{place}: the stamp {batch.sampled[i]:.10g} s is {format_duration(early)} after the arrival "
                    f"{batch.arrived[i]:.10g} s, so they are of two clocks or units; convert the arrivals to the clock of the "
                    "stamps, or leave them out and give a delay."
                )
            raise UserError(
                f"{place}: got {got.format(value=batch.value[i], early=early)}, expected {expected}; correct or leave out that "
                "row."
            )


def require_forward(where: str, before: float, rows: Rows) -> None:
    """Raise UserError with the first row of inputs or truth whose time is missing, or not after the previous row."""
    back = ~(np.diff(rows.t, prepend=before) > 0)
    if back.any():
        i = int(np.argmax(back))
        earlier = rows.t[i - 1] if i else before
        raise UserError(
            f"{where}: row {rows.row[i]}: got the time {rows.t[i]:.9g} s after {earlier:.9g} s, expected later times; "
            "sort the rows, and remove repeated ones."
        )


class TimeColumn(NamedTuple):
    """One column of times."""

    name: str  # in messages
    fix: str  # how to convert it, in messages
    times: RunningStats  # marked by row


def require_one_clock(where: str, columns: Sequence[TimeColumn]) -> None:
    """Raise UserError for times of two clocks, with the row, or with the columns that differ."""
    columns = [c for c in columns if c.times.many]
    selections = [c.times.selection[:, 1] for c in columns]
    times = np.unique(np.concatenate([*([c.times.least, c.times.most] for c in columns), *selections]))
    gaps = np.diff(times)
    order = np.argsort(-gaps, kind="stable")
    for i, gap_index in enumerate(order[:GAPS]):
        before, after = float(times[gap_index]), float(times[gap_index + 1])
        mixed = [c for c in columns if c.times.least <= before and c.times.most >= after]
        if gaps[gap_index] <= max(FACTOR * gaps[order[i + 1 :]].sum(), DAY if mixed else HOUR):
            continue
        far = format_duration(after - before)
        if mixed:  # most times of the log are right
            s, is_before = mixed[0].times, np.concatenate(selections) <= before
            few = 2 * is_before.sum() <= len(is_before)
            wrong, row, side = (s.least, s.least_mark, "before") if few else (s.most, s.most_mark, "after")
            raise UserError(
                f"{where}: row {int(row)} has {wrong:.10g} s among the {mixed[0].name}, {far} {side} the other times of the "
                "log, so it is of another clock; remove that row or convert its time."
            )
        first, last = ([c for c in columns if (c.times.most <= before) == side] for side in (True, False))
        names = [f"{c[0].name}{' and others' if len(c) > 1 else ''}" for c in (first, last)]
        raise UserError(
            f"{where}: the {names[0]} end at {before:.10g} s and the {names[1]} begin at {after:.10g} s, {far} apart, so they "
            f"are of two clocks or units; {(last if columns[0].times.most <= before else first)[0].fix}."
        )


def format_duration(seconds: float) -> str:
    """Return a duration as text."""
    for unit, name in ((YEAR, "years"), (DAY, "days"), (HOUR, "hours")):
        if seconds >= unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.3g} s"
