"""What is in a log, found by reading it once: of every channel its rate, gaps and delays, and what is odd about its stamps.

Intervals are between successive stamps of a channel. A *gap* is an interval of more than five medians. A delay is arrival less
stamp; it *jumps* where it differs from the one before by more than ten times the middle half of all delays and half an
interval. Its *drift* is by how much the clock of the stamps is fast beside that of the arrivals, as in the axis clock_skew:
minus the slope of the line through all delays.
A sample is *out of order* where one with a later stamp stands before it, *doubled* where its stamp stands there twice.
Stamps are compared within a part of the log, some 65,000 rows, and with the newest of the part before.

What is in a log as a table, a row a channel.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.recordings import clocks, readers
from pcbench.recordings.clocks import Times
from pcbench.recordings.log import Batch, Log, Table, require_sound
from pcbench.recordings.running_stats import Line, Spread, add, fit, largest

if TYPE_CHECKING:
    import pandas as pd

GAP = 5.0  # medians of an interval
JUMP = 10.0  # middle halves of the delays


class Seen(NamedTuple):
    """What is known of one channel. Tops are rows (size, time [s], row of the log), the largest first."""

    samples: int = 0
    lost: int = 0
    first: float = np.nan  # [s] stamps
    last: float = np.nan
    newest: float = -np.inf  # [s] the latest stamp so far,
    delayed: float = np.nan  # [s] and the delay of the sample before
    intervals: Spread = Spread()
    delays: Spread = Spread()
    drift: Line = Line()
    out_of_order: int = 0
    out_of_order_row: int = 0  # of the first
    doubled: int = 0
    doubled_row: int = 0  # of the first
    long: NDArray[Any] = np.zeros((0, 3))  # the longest intervals
    steps: NDArray[Any] = np.zeros((0, 3))  # the largest changes from one delay to the next
    stamps: Times = Times("", "")
    arrivals: Times = Times("", "")


class Survey(NamedTuple):
    """What is known of a log."""

    channels: dict[str, Seen]
    rows: int
    start: float  # [s] the earliest stamp
    end: float  # [s] the latest stamp or arrival
    behind: float  # [s] how far behind the latest stamp before it a row's may be
    grid: NDArray[Any]  # [K] s, some of the stamps and arrivals, less the start
    tables: dict[str, Times]  # the times of inputs and truth, of those that the log has


def survey(log: Log) -> Survey:
    """Read a log once; raise UserError for a row that no run can be fed with, and for times of two clocks."""
    seen = [_unseen(name) for name in log.channels]
    rows, start, end, behind, newest, grid = 0, np.inf, -np.inf, 0.0, -np.inf, Spread()
    for batch in log.measurements():
        if not len(batch.row):
            continue
        require_sound(log, batch)
        for c in np.unique(batch.channel):
            mine = batch.channel == c
            seen[c] = _more(seen[c], Batch(*(column[mine] for column in batch)))
        latest = np.maximum.accumulate(np.maximum(batch.sampled, newest))
        behind, newest = max(behind, float((latest - batch.sampled).max())), float(latest[-1])
        rows, start = rows + len(batch.row), min(start, float(batch.sampled.min()))
        end = max(end, newest, float(np.nanmax(batch.arrived, initial=-np.inf)))
        both = np.concatenate([batch.sampled, batch.arrived[~np.isnan(batch.arrived)]])
        grid = add(grid, both, both)
    if not rows:
        raise UserError(f"{log.name}: got no samples, expected one at least; see which topic or channel is meant.")
    tables = {name: _times(table, name) for name, table in (("inputs", log.inputs), ("truth", log.truth)) if table}
    clocks.require_one(log.name, [*(s.stamps for s in seen), *(s.arrivals for s in seen), *tables.values()])
    return Survey(
        channels=dict(zip(log.channels, seen, strict=True)),
        rows=rows,
        start=start,
        end=end,
        behind=behind,
        grid=grid.kept[:, 1] - start,
        tables=tables,
    )


def _unseen(channel: str) -> Seen:
    fix = "convert the arrivals to the clock of the stamps, or leave them out and give a delay"
    return Seen(
        stamps=Times(f"stamps of channel {channel}", "convert its stamps to the clock of the other channels"),
        arrivals=Times(f"arrivals of channel {channel}", fix),
    )


def _times(table: Table, name: str) -> Times:
    """The times of a table of inputs or truth."""
    times = Times(f"times of the {name}", f"convert the times of the {name} to the clock of the stamps")
    for rows in table.read():
        times = clocks.more(times, rows.t, rows.row)
    return times


def _more(seen: Seen, batch: Batch) -> Seen:
    """What is known of a channel with some samples more."""
    lost = np.isnan(batch.arrived)
    delay = (batch.arrived - batch.sampled)[~lost]
    order = np.argsort(batch.sampled, kind="stable")
    stamps, rows = batch.sampled[order], batch.row[order].astype(float)
    before = np.concatenate([[seen.newest], stamps[:-1]])
    steps = stamps - before
    forward, again = np.isfinite(steps) & (steps > 0), steps == 0
    earlier = np.maximum.accumulate(np.concatenate([[seen.newest], batch.sampled[:-1]]))
    behind = batch.sampled < earlier
    change = np.abs(np.diff(delay, prepend=seen.delayed))
    there = np.isfinite(change)
    origin = seen.first if seen.samples else float(batch.sampled[0])
    at, arrived = batch.sampled[~lost], batch.row[~lost].astype(float)
    return Seen(
        samples=seen.samples + len(stamps),
        lost=seen.lost + int(lost.sum()),
        first=origin,
        last=float(np.nanmax([seen.last, stamps[-1]])),
        newest=max(seen.newest, float(stamps[-1])),
        delayed=float(delay[-1]) if delay.size else seen.delayed,
        intervals=add(seen.intervals, stamps[forward], steps[forward]),
        delays=add(seen.delays, at, delay),
        drift=fit(seen.drift, at - origin, delay),
        out_of_order=seen.out_of_order + int(behind.sum()),
        out_of_order_row=seen.out_of_order_row or (int(batch.row[np.argmax(behind)]) if behind.any() else 0),
        doubled=seen.doubled + int(again.sum()),
        doubled_row=seen.doubled_row or (int(rows[np.argmax(again)]) if again.any() else 0),
        long=largest(seen.long, steps[forward], stamps[forward], rows[forward]),
        steps=largest(seen.steps, change[there], at[there], arrived[there]),
        stamps=clocks.more(seen.stamps, batch.sampled, batch.row),
        arrivals=clocks.more(seen.arrivals, batch.arrived, batch.row),
    )


def gaps(seen: Seen) -> NDArray[Any]:
    """Return the gaps of a channel, a hundred at most: (length [s], stamp at their end [s], row)."""
    (median,) = seen.intervals.quantiles((0.5,))
    return seen.long[seen.long[:, 0] > GAP * median]


def jumps(seen: Seen) -> NDArray[Any]:
    """Return where the delay of a channel jumps, a hundred at most: (by how much [s], stamp [s], row)."""
    low, high = seen.delays.quantiles((0.25, 0.75))
    (median,) = seen.intervals.quantiles((0.5,))
    return (
        seen.steps[seen.steps[:, 0] > max(JUMP * (high - low), 0.5 * median)] if seen.intervals.many else seen.steps[:0]
    )


def described(found: Survey) -> list[dict[str, Any]]:
    """Return what `pcbench info` says of every channel, times in seconds, ready for JSON: NaN is None."""
    return [
        {key: None if isinstance(v, float) and not np.isfinite(v) else v for key, v in _row(name, seen).items()}
        for name, seen in found.channels.items()
    ]


def _row(name: str, seen: Seen) -> dict[str, Any]:
    interval, delay = seen.intervals, seen.delays
    p05, p50, p95 = delay.quantiles((0.05, 0.5, 0.95))
    (median,) = interval.quantiles((0.5,))
    apart, stepped = gaps(seen), jumps(seen)
    slope, se = seen.drift.slope()
    return {
        "channel": name,
        "samples": seen.samples,
        "lost": seen.lost,
        "first": seen.first,
        "last": seen.last,
        "rate": 1 / interval.mean if interval.many else np.nan,
        "interval_median": median,
        "interval_least": interval.least,
        "interval_most": interval.most,
        "gaps": len(apart),
        "longest_gap": float(apart[0, 0]) if len(apart) else np.nan,
        "longest_gap_row": int(apart[0, 2]) if len(apart) else None,
        "delay_mean": delay.mean,
        "delay_least": delay.least,
        "delay_p05": p05,
        "delay_median": p50,
        "delay_p95": p95,
        "delay_most": delay.most,
        "out_of_order": seen.out_of_order,
        "out_of_order_row": seen.out_of_order_row or None,
        "doubled": seen.doubled,
        "doubled_row": seen.doubled_row or None,
        "jumps": len(stepped),
        "largest_jump": float(stepped[0, 0]) if len(stepped) else np.nan,
        "largest_jump_row": int(stepped[0, 2]) if len(stepped) else None,
        "drift_ppm": -1e6 * slope,
        "drift_ppm_se": 1e6 * se,
    }


def info(name: str | Path, *, delay: float | None = None) -> "pd.DataFrame":
    """Return what is in a log, a row a channel: rate, gaps and delays [s], samples out of order or doubled, stamps that drift.

    `name` is a folder or file of tables, or a TOML that says what of a bag is which channel; `delay` [s] stands for arrivals
    that it does not have. `log(...).attrs["survey"]` has what the picture `plots.delays` shows. Raises UserError with the row.
    """
    import pandas as pd

    found = survey(readers.opened(name, delay))
    table = pd.DataFrame(described(found))
    table.attrs = {"survey": found, "name": str(name)}
    return table
