"""Schedules that are written down at once: of one clock whose samples are a period apart, and of every tick."""

import numpy as np

from pcbench.simulation.schedule.common_times import Schedule, at_no_tick, with_events
from pcbench.simulation.schedule.sampling import Clock


def regular(clock: Clock, ticks: int, channels: int) -> tuple[Schedule, int]:
    """Return the `schedule` of a plain clock alone, of whose age observers believe what is so, and its packets `in_flight`.

    It has no loops.
    """
    n, q = ticks + 1, list(clock.channels)
    taken = np.arange(0, n, clock.period, dtype=np.int32)
    late = np.int32(clock.period if clock.delay is None else clock.delay)
    arrives = taken + late
    here = arrives <= ticks
    number, at = np.arange(len(taken), dtype=np.int32), arrives[here]
    out = at_no_tick(ticks, channels)
    out.sense[taken] = out.snapshot[taken] = number
    out.sample[taken[:, None], q] = number[:, None]
    out.arrive[at, 0], out.believed[at, 0], out.ticks_since_arrival[at, 0] = (
        number[here],
        taken[here],
        np.diff(at, prepend=0),
    )
    out.mask[at[:, None], 0, q] = True
    out.number[at[:, None], 0, q] = number[here, None]
    return with_events(out), 1 + int(late) // clock.period * bool(len(at))


def at_every_tick(ticks: int, channels: int) -> Schedule:
    """Take all channels at every tick and hand them over at once: `schedule` of period 1 and delay 0, without its loops."""
    k = np.arange(ticks + 1, dtype=np.int32)
    row, each = k[:, None], np.repeat(k[:, None], channels, 1)
    return Schedule(
        sense=k,
        sample=each,
        snapshot=k,
        arrive=row,
        believed=row,
        mask=np.ones((ticks + 1, 1, channels), bool),
        number=each[:, None],
        ticks_since_arrival=np.minimum(row, 1),
        event=np.ones(ticks + 1, bool),
        next_event=k + np.int32(1),
        early=each[:0],
        also=np.zeros((ticks + 1, 0), np.int32),
    )
