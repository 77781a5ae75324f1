"""A log's samples as ticks, in the order in which they were taken, a stretch of ticks at a time.

A stretch holds all that is taken or arrives in it. Rows may stand in any order: a stretch is complete once a row has been read
whose stamp is later than its end by as much as any row is behind (`Survey.behind`).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pcbench.errors import UserError
from pcbench.recordings.log import Batch, Floats, Ints, Log, require_sound
from pcbench.recordings.survey import Survey
from pcbench.recordings.ticks import NEVER, ticks


class Samples(NamedTuple):
    """K samples, in the order in which they were taken, at one tick in the order of channels."""

    channel: Ints  # [K]
    taken: Ints  # [K] tick
    arrives: Ints  # [K] tick, not before `taken`; NEVER of one that was lost
    value: Floats  # [K]
    row: Ints  # [K]
    number: Ints  # [K] which sample of its channel, from 0
    packet: Ints  # [K] which sampling instant, from 0


class Stretch(NamedTuple):
    """Ticks first .. end - 1 of a log."""

    first: int
    end: int
    taken: Samples  # those taken in it
    arriving: Samples  # those that arrive in it, by tick of arrival, then of taking


class Clocked(NamedTuple):
    """What turns a log's seconds into ticks."""

    start: float  # [s] of the log's clock, tick 0
    dt: float  # [s]


def stretches(log: Log, found: Survey, clock: Clocked, length: int, last: int) -> Iterator[Stretch]:
    """Yield a log in stretches of `length` ticks, the last one with tick `last` in it.

    Raises UserError where two samples of a channel fall on one tick. What was taken before tick 0 or after `last` is left out.
    """
    numbers, packets, first = np.zeros(len(log.channels), int), 0, 0
    waiting = on_the_way = _sorted(_none(), [])
    read, newest, done = log.measurements(), -np.inf, False
    while first <= last:
        end = first + length
        while not done and newest - found.behind <= clock.start + end * clock.dt:
            batch = next(read, None)
            if batch is None:
                done = True
            elif len(batch.row):
                require_sound(log, batch)
                newest = max(newest, float(batch.sampled.max()))
                waiting = _sorted(waiting, [_in_ticks(batch, clock, last)])
        here = waiting.taken < end
        taken, waiting = _some(waiting, here), _some(waiting, ~here)
        _require_apart(log, taken, clock.dt)
        taken, packets = _numbered(taken, numbers, packets)
        every = _joined([on_the_way, taken])
        on_the_way, now = (
            _some(every, (every.arrives >= end) & (every.arrives < NEVER)),
            _some(every, every.arrives < end),
        )
        yield Stretch(first, end, taken, _some(now, np.lexsort((now.channel, now.taken, now.arrives))))
        first = end


def _none() -> Samples:
    nothing = np.zeros(0, np.int64)
    return Samples(nothing, nothing, nothing, np.zeros(0), row=nothing, number=nothing, packet=nothing)


def _in_ticks(batch: Batch, clock: Clocked, last: int) -> Samples:
    taken, arrives = (ticks(times, clock.start, clock.dt)[0] for times in (batch.sampled, batch.arrived))
    nothing = np.zeros(len(taken), np.int64)
    every = Samples(batch.channel, taken, arrives, batch.value, row=batch.row, number=nothing, packet=nothing)
    return _some(every, (taken >= 0) & (taken <= last))


def _some(samples: Samples, which: np.ndarray) -> Samples:
    return Samples(*(column[which] for column in samples))


def _joined(parts: list[Samples]) -> Samples:
    return Samples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _sorted(before: Samples, more: list[Samples]) -> Samples:
    every = _joined([before, *more])
    return _some(every, np.lexsort((every.channel, every.taken)))


def _numbered(taken: Samples, numbers: np.ndarray, packets: int) -> tuple[Samples, int]:
    """Samples with their numbers, counted on in `numbers` by channel; and how many packets there have been."""
    number = np.zeros(len(taken.taken), np.int64)
    for c in range(len(numbers)):
        mine = taken.channel == c
        number[mine] = numbers[c] + np.arange(mine.sum())
        numbers[c] += mine.sum()
    new = np.diff(taken.taken, prepend=-1) != 0
    packet = packets - 1 + np.cumsum(new)
    return taken._replace(number=number, packet=packet), packets + int(new.sum())


def _require_apart(log: Log, taken: Samples, dt: float) -> None:
    same = (np.diff(taken.taken) == 0) & (np.diff(taken.channel) == 0)
    if same.any():
        i = int(np.argmax(same))
        raise UserError(
            f"{log.name}: row {taken.row[i + 1]} of channel {log.channels[taken.channel[i]]}: got a sample on the same tick of "
            f"{dt:g} s as row {taken.row[i]}, expected one at most; leave the doubled sample out, or take a shorter tick."
        )
