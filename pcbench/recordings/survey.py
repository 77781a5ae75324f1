"""Survey a recording in one pass: rate, gaps, delays and irregular timestamps of every channel.

- Intervals are between successive timestamps of a channel. A *gap* is an interval of more than five medians.
- A delay is arrival minus timestamp. It *jumps* if it differs from the previous one by more than ten times the interquartile
  range of all delays plus half an interval.
- The *drift* is the rate by which the clock of the timestamps is fast relative to that of the arrivals, as in the axis
  clock_skew: minus the slope of the line through all delays.
- A sample is *out of order* if one with a later timestamp precedes it, *doubled* if its timestamp occurs twice.
- A value is *repeated* if it equals that of the row before.

Timestamps are compared within a part of the recording, some 65,000 rows, and with the newest of the previous part.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pcbench.errors import UserError
from pcbench.recordings import readers
from pcbench.recordings.lags import lags_of
from pcbench.recordings.log import Batch, Floats, Log, Rows
from pcbench.recordings.running_stats import RunningStats, add, largest, slope
from pcbench.recordings.times import TimeColumn, require_one_clock, require_sound

if TYPE_CHECKING:
    import pandas as pd

    from pcbench.recordings.tables import Frames

GAP = 5.0  # in medians of an interval
JUMP = 10.0  # in interquartile ranges of the delays
HELD = 0.2  # share of repeated values above which this is reported


class ChannelStats(NamedTuple):
    """Statistics of one channel, with rows of the log. Tops are (size, time [s], row), the largest first."""

    stamps: RunningStats = RunningStats()  # [s] by row
    arrivals: RunningStats = RunningStats()  # [s] by row
    intervals: RunningStats = RunningStats()  # by timestamp
    delays: RunningStats = RunningStats()  # by timestamp
    out_of_order: RunningStats = RunningStats()  # timestamps by row
    doubled: RunningStats = RunningStats()  # timestamps by row
    last_delay: float = np.nan  # delay of the previous sample
    drift: Floats = np.zeros(6)  # sums for a line
    longest: Floats = np.zeros((0, 3))  # intervals
    steps: Floats = np.zeros((0, 3))  # largest changes from one delay to the next
    values: RunningStats = RunningStats()  # by row
    repeated: int = 0
    last_value: float = np.nan  # value of the previous row
    stds: int = 0  # samples with a stated standard deviation
    without_std: int | None = None  # first row without one

    @property
    def constant(self) -> bool:
        """Whether all its values are equal."""
        return self.values.many > 1 and self.values.least == self.values.most

    def gaps(self) -> Floats:
        """Return the gaps, at most a hundred: (length [s], timestamp at their end [s], row)."""
        return self.longest[self.longest[:, 0] > GAP * self.intervals.median]

    def jumps(self) -> Floats:
        """Return the jumps of the delay, at most a hundred: (size [s], timestamp [s], row)."""
        low, high = self.delays.quantiles(0.25, 0.75)
        limit = max(JUMP * (high - low), 0.5 * self.intervals.median) if self.intervals.many else np.inf
        return self.steps[self.steps[:, 0] > limit]


class Survey(NamedTuple):
    """Statistics of a recording."""

    channels: dict[str, ChannelStats]
    rows: int
    start: float  # [s] earliest timestamp
    end: float  # [s] latest timestamp or arrival
    behind: float  # [s] how far a row's timestamp may be behind an earlier row's
    grid: Floats  # [K] s, some of the timestamps and arrivals, minus the start
    tables: dict[str, RunningStats]  # times of inputs and truth, if recorded

    def with_std(self) -> list[str]:
        """Return the channels whose samples have stated standard deviations."""
        return [name for name, c in self.channels.items() if c.stds]


def survey(log: Log) -> Survey:
    """Read a log once; raise UserError for an invalid row, and for times of two clocks."""
    stats = [ChannelStats() for _ in log.channels]
    behind, newest, grid = 0.0, -np.inf, RunningStats()
    for batch in log.measurements():
        if not len(batch.row):
            continue
        require_sound(log, batch)
        for c in np.unique(batch.channel):
            stats[c] = _update(stats[c], batch.select(batch.channel == c))
        latest = np.maximum.accumulate(np.maximum(batch.sampled, newest))
        behind, newest = max(behind, float((latest - batch.sampled).max())), float(latest[-1])
        times = np.concatenate([batch.sampled, batch.arrived])
        grid = add(grid, times, times)
    if not grid.many:
        raise UserError(f"{log.name}: got no samples, expected one at least; name another topic or channel.")
    channels, tables = dict(zip(log.channels, stats, strict=True)), {}
    for name, c in channels.items():
        if c.stds and c.without_std is not None:
            raise UserError(
                f"{log.name}: row {c.without_std} of channel {name}: got no standard deviation, expected one as in other rows "
                "of that channel; write it, or leave it out of all."
            )
    for name, table in (("inputs", log.inputs), ("truth", log.truth)):
        if table:
            tables[name] = RunningStats()
            for part in table.read():
                tables[name] = add(tables[name], part.row, part.t)
    stamp_fix, arrival_fix = (
        "convert its stamps to the clock of the other channels",
        "convert the arrivals to the clock of the stamps, or leave them out and give a delay",
    )
    columns = [TimeColumn(f"stamps of channel {name}", stamp_fix, c.stamps) for name, c in channels.items()]
    columns += [TimeColumn(f"arrivals of channel {name}", arrival_fix, c.arrivals) for name, c in channels.items()]
    for name, spread in tables.items():
        fix = f"convert the times of the {name} to the clock of the stamps"
        columns.append(TimeColumn(f"times of the {name}", fix, spread))
    require_one_clock(log.name, columns)
    start = min(c.stamps.least for c in stats)
    return Survey(
        channels=channels,
        rows=sum(c.stamps.many for c in stats),
        start=start,
        end=max(grid.most, start),
        behind=behind,
        grid=grid.selection[:, 1] - start,
        tables=tables,
    )


def _update(c: ChannelStats, batch: Batch) -> ChannelStats:
    """Return the statistics of a channel after further samples."""
    arrived, order = ~np.isnan(batch.arrived), np.argsort(batch.sampled, kind="stable")
    at, delay = batch.sampled[arrived], (batch.arrived - batch.sampled)[arrived]
    stamps, sorted_rows, newest = batch.sampled[order], batch.row[order], c.stamps.most
    steps = stamps - np.concatenate([[newest], stamps[:-1]])
    forward, is_duplicate = np.isfinite(steps) & (steps > 0), steps == 0
    behind = batch.sampled < np.maximum.accumulate(np.concatenate([[newest], batch.sampled[:-1]]))
    change = np.abs(np.diff(delay, prepend=c.last_delay))
    has_change = np.isfinite(change)
    stamp_stats, measured = add(c.stamps, batch.row, batch.sampled), batch.value[~np.isnan(batch.value)]
    x = at - stamp_stats.selection[0, 1]  # since the first timestamp
    has_std = ~np.isnan(batch.std) if len(batch.std) else np.zeros(len(batch.row), bool)
    row_without_std = None if has_std.all() else int(batch.row[np.argmin(has_std)])
    sums = [x.size, x.sum(), delay.sum(), (x * x).sum(), (x * delay).sum(), (delay * delay).sum()]
    return ChannelStats(
        stamps=stamp_stats,
        arrivals=add(c.arrivals, batch.row, batch.arrived),
        intervals=add(c.intervals, stamps[forward], steps[forward]),
        delays=add(c.delays, at, delay),
        out_of_order=add(c.out_of_order, batch.row[behind], batch.sampled[behind]),
        doubled=add(c.doubled, sorted_rows[is_duplicate], stamps[is_duplicate]),
        last_delay=float(delay[-1]) if delay.size else c.last_delay,
        drift=c.drift + np.array(sums),
        longest=largest(c.longest, steps[forward], stamps[forward], sorted_rows[forward]),
        steps=largest(c.steps, change[has_change], at[has_change], batch.row[arrived][has_change]),
        values=add(c.values, batch.row, batch.value),
        repeated=c.repeated + int((np.diff(measured, prepend=c.last_value) == 0).sum()),
        last_value=float(measured[-1]) if len(measured) else c.last_value,
        stds=c.stds + int(has_std.sum()),
        without_std=row_without_std if c.without_std is None else c.without_std,
    )


def limit_truth(log: Log, stats: Survey, signals: list[str]) -> tuple[Log, Survey, list[str]]:
    """Return a log with truth only where there are measurements, and a sentence on each omission.

    Truth may begin and end five sampling periods of the slowest channel outside them.
    Raises UserError if no truth is left.
    """
    if log.truth is None:
        return log, stats, []
    out, table, times = [], log.truth, stats.tables["truth"]
    if not_states := [name for name in table.names if name not in signals]:
        out.append(f"truth: {', '.join(not_states)}: no state of the plant ({', '.join(signals)}); left out.")
    if not times.many:
        out.append(f"{log.name} has a truth without any value; errors are not computed.")
        return (
            log._replace(truth=None),
            stats._replace(tables={k: v for k, v in stats.tables.items() if k != "truth"}),
            out,
        )
    margin = GAP * max((c.intervals.median for c in stats.channels.values() if c.intervals.many), default=np.inf)
    low, high = stats.start - margin, stats.end + margin
    if low <= times.least and times.most <= high:
        return log, stats, out
    if times.most < low or high < times.least:
        raise UserError(
            f"{log.name}: got truth from {times.least:.6g} to {times.most:.6g} s and measurements from {stats.start:.6g} to "
            f"{stats.end:.6g} s, expected a common time; convert the times of the truth, or leave it out."
        )

    def read() -> Iterator[Rows]:
        for part in table.read():
            inside = (low <= part.t) & (part.t <= high)
            yield Rows(part.t[inside], part.values[inside], part.row[inside])

    inside = RunningStats()
    for part in read():
        inside = add(inside, part.row, part.t)
    out.append(f"truth before {low:.6g} s and after {high:.6g} s is left out: there are no measurements.")
    return log._replace(truth=table._replace(read=read)), stats._replace(tables=stats.tables | {"truth": inside}), out


def require_units(log: Log, expected: list[str]) -> None:
    """Raise UserError if a recording and the plant have different units of a channel; 1 and empty are unknown units."""
    for name, unit, plant_unit in zip(log.channels, log.units, expected, strict=False):
        if unit not in ("", "1", plant_unit) and plant_unit not in ("", "1"):
            raise UserError(
                f"{log.name}: channels.{name}: got the unit {unit}, expected {plant_unit} as in the plant; write scale = "
                f'FACTOR and unit = "{plant_unit}".'
            )


def describe_held(log: Survey) -> list[str]:
    """Return a sentence for each channel whose value never changes, or is often repeated."""
    out = []
    for name, c in log.channels.items():
        if c.constant:
            out.append(f"{name} never changes: all of {c.values.many:,} values are {c.values.least:.6g}.")
        elif c.repeated > HELD * c.values.many:
            out.append(
                f"{name}: {c.repeated:,} of {c.values.many:,} values repeat the one before; if these are held, not measured, "
                "write only_changes = true for the channel in a TOML."
            )
    return out


def channel_rows(log: Survey) -> list[dict[str, object]]:
    """Return the rows of `pcbench info`, one per channel, times in seconds, ready for JSON: NaN is None."""
    return [
        {key: None if isinstance(v, float) and not np.isfinite(v) else v for key, v in _row(name, c).items()}
        for name, c in log.channels.items()
    ]


def _row(name: str, c: ChannelStats) -> dict[str, object]:
    interval, delay, gaps, jumps = c.intervals, c.delays, c.gaps(), c.jumps()
    p05, p50, p95 = delay.quantiles(0.05, 0.5, 0.95)
    drift, se = slope(c.drift)
    return {
        "channel": name,
        "samples": c.stamps.many,
        "lost": c.stamps.many - delay.many,
        "first": c.stamps.selection[0, 1] if c.stamps.many else np.nan,
        "last": c.stamps.most if c.stamps.many else np.nan,
        "rate": 1 / interval.mean if interval.many else np.nan,
        "interval_median": interval.median,
        "interval_least": interval.least,
        "interval_most": interval.most,
        "gaps": len(gaps),
        "longest_gap": float(gaps[0, 0]) if len(gaps) else np.nan,
        "longest_gap_row": int(gaps[0, 2]) if len(gaps) else None,
        "delay_mean": delay.mean,
        "delay_least": delay.least,
        "delay_p05": p05,
        "delay_median": p50,
        "delay_p95": p95,
        "delay_most": delay.most,
        "out_of_order": c.out_of_order.many,
        "out_of_order_row": c.out_of_order.first_mark,
        "doubled": c.doubled.many,
        "doubled_row": c.doubled.first_mark,
        "jumps": len(jumps),
        "largest_jump": float(jumps[0, 0]) if len(jumps) else np.nan,
        "largest_jump_row": int(jumps[0, 2]) if len(jumps) else None,
        "least": c.values.least if c.values.many else np.nan,
        "most": c.values.most if c.values.many else np.nan,
        "constant": c.constant,
        "repeated": c.repeated,
        "drift_ppm": -1e6 * drift,
        "drift_ppm_se": 1e6 * se,
    }


def info(name: "str | Path | Frames", *, delay: float | None = None) -> "pd.DataFrame":
    """Summarize a recording: rates, gaps, delays, order and clock of each channel.

    Args:
        name: folder or file of tables, or a TOML file that maps its fields to channels; or frames (see `replay`).
        delay: delay of every measurement [s], for a recording without arrival times.

    Returns:
        A frame with one row per channel. `attrs["survey"]` has what the figure `plots.delays` shows, `attrs["lags"]` the lag
        of each two channels that are alike, with a 95 % interval (see `recordings.lags`).

    Raises:
        UserError: the recording cannot be read; the sentence names file and row.
    """
    import pandas as pd

    recording = readers.open_log(name, delay)
    stats = survey(recording)
    table = pd.DataFrame(channel_rows(stats))
    table.attrs = {
        "survey": stats,
        "name": str(name) if isinstance(name, str | Path) else "frames",
        "lags": lags_of(recording),
    }
    return table
