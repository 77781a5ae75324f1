"""What a log feeds to observers at every tick: samples (`recordings.windows`), inputs held until the next row, truth if known.

Rows of inputs and truth count from the nearest tick on; of several at one tick the last one does.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pcbench.errors import UserError
from pcbench.recordings.events import Clocked, stretches
from pcbench.recordings.log import Floats, Log, Rows, Table, require_forward
from pcbench.recordings.survey import Survey
from pcbench.recordings.ticks import ticks
from pcbench.recordings.windows import Room, Tally, Window, tally, window


class Part(NamedTuple):
    """K ticks of a log, from tick `first` on; m inputs, n + s signals."""

    first: int
    window: Window
    inputs: Floats  # [back + K, m] from tick first - back on; those before tick 0 are 0
    truth: Floats  # [K, n + s] NaN where it is not known; [K, 0]: of none


def room(log: Log, found: Survey, clock: Clocked, length: int, last: int) -> Room:
    """Return what a log needs room for; it is read once."""
    latest = int(np.ceil(max((s.delays.most for s in found.channels.values()), default=0.0) / clock.dt)) + 1
    so_far = Tally()
    for stretch in stretches(log, found, clock, length, last):
        so_far = tally(so_far, stretch, max(latest, 0))
    return so_far.room


def parts(
    log: Log, found: Survey, clock: Clocked, length: int, last: int, slots: int, back: int, m: int, signals: int
) -> Iterator[Part]:
    """Yield a log in parts of `length` ticks, with `back` ticks of inputs before each; `signals` 0: no truth is asked for."""
    inputs = held(log.inputs, f"{log.name}: inputs", clock, m, length, last)
    truth = at_ticks(log.truth, f"{log.name}: truth", clock, signals, length, last)
    before, arrived = np.zeros((back, m)), 0
    for stretch in stretches(log, found, clock, length, last):
        laid, arrived = window(stretch, len(log.channels), slots, arrived)
        whole = np.concatenate([before, next(inputs)])
        yield Part(stretch.first, laid, whole, next(truth))
        before = whole[len(whole) - back :]


def held(table: Table | None, where: str, clock: Clocked, m: int, length: int, last: int) -> Iterator[Floats]:
    """Yield the inputs [length, m] of every stretch of ticks: those of the last row before, 0 before the first."""
    value = np.zeros(m)
    for rows in at_ticks(table, where, clock, m, length, last):
        there = ~np.isnan(rows).all(1) if m else np.zeros(length, bool)
        newest = np.maximum.accumulate(np.where(there, np.arange(length), -1))
        out = np.where((newest >= 0)[:, None], rows[np.maximum(newest, 0)], value)
        value = out[-1]
        yield out


def at_ticks(table: Table | None, where: str, clock: Clocked, many: int, length: int, last: int) -> Iterator[Floats]:
    """Yield the rows of a table as [length, many] of every stretch of ticks, NaN where there is none."""
    read = _in_ticks(table, where, clock, many) if table and many else iter(())
    waiting: list[Rows] = []
    for first in range(0, last + 1, length):
        out = np.full((length, many), np.nan)
        while not waiting or waiting[-1].t[-1] < first + length:
            more = next(read, None)
            if more is None:
                break
            waiting.append(more)
        for rows in waiting:
            here = (rows.t >= first) & (rows.t < first + length)
            out[rows.t[here].astype(int) - first] = rows.values[here]
        waiting = [rows for rows in waiting if rows.t[-1] >= first + length]
        yield out


def _in_ticks(table: Table, where: str, clock: Clocked, many: int) -> Iterator[Rows]:
    before = -np.inf
    for rows in table.read():
        if not len(rows.t):
            continue
        require_forward(where, before, rows)
        before = float(rows.t[-1])
        bad = ~np.isfinite(rows.values)
        if bad.any():
            i, j = (int(place[0]) for place in np.nonzero(bad))
            raise UserError(
                f"{where}: row {rows.row[i]}: got {rows.values[i, j]} as {table.names[j]}, expected a finite number; mend or "
                "leave out that row."
            )
        yield rows._replace(t=ticks(rows.t, clock.start, clock.dt)[0].astype(float))


def require_columns(table: Table | None, names: list[str], where: str) -> list[int]:
    """Return the places of columns in a table; raise UserError where one is missing."""
    there = table.names if table else ()
    missing = [name for name in names if name not in there]
    if missing:
        raise UserError(
            f"{where}: got the columns {', '.join(there) or 'none'}, expected {', '.join(names)}; write {missing[0]}."
        )
    return [there.index(name) for name in names]
