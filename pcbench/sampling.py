"""The delayed sampler as integer data: which sample is taken and which arrives at every tick.

Everything is a whole number of ticks. One *packet* is one sampling instant: whatever channels are sampled at that tick
travel under one number, each with a delay of its own, so a packet may arrive in parts. At a tick, arrivals are handed
over one packet at a time, the oldest first; each has a slot.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]


class Schedule(NamedTuple):
    """N + 1 ticks, q channels, S arrival slots a tick; -1 means nothing."""

    sense: Ints  # [N+1] the packet taken at this tick
    sampled: Bools  # [N+1, q] the channels in it
    sample: Ints  # [N+1, q] which sample of its channel, from 0
    arrive: Ints  # [N+1, S] the packets that arrive
    sent: Ints  # [N+1, S] the tick at which each was taken
    fresh: Bools  # [N+1, S, q] the channels that arrive with it
    number: Ints  # [N+1, S, q] which sample of its channel
    since: Ints  # [N+1, S] ticks since the last tick at which anything arrived (from 0 before the first)
    event: Bools  # [N+1] anything taken or arriving
    next_event: Ints  # [N+1] the first later tick with an event, or N + 1


class Sample(NamedTuple):
    """One channel measured once."""

    channel: int
    number: int  # which sample of its channel, from 0
    taken: int  # tick
    arrives: int  # tick, not before `taken`


def schedule(samples: list[Sample], ticks: int, channels: int) -> Schedule:
    """Lay samples out over ticks 0 .. `ticks`; what is taken or arrives later is left out."""
    instants = sorted({s.taken for s in samples if s.taken <= ticks})
    packet = {tick: i for i, tick in enumerate(instants)}
    by_arrival: dict[int, dict[int, list[Sample]]] = {}
    for s in samples:
        if s.taken <= ticks and s.arrives <= ticks:
            by_arrival.setdefault(s.arrives, {}).setdefault(s.taken, []).append(s)
    slots = max((len(group) for group in by_arrival.values()), default=1)
    n, q = ticks + 1, channels
    out = Schedule(
        sense=np.full(n, -1, np.int32),
        sampled=np.zeros((n, q), bool),
        sample=np.full((n, q), -1, np.int32),
        arrive=np.full((n, slots), -1, np.int32),
        sent=np.zeros((n, slots), np.int32),
        fresh=np.zeros((n, slots, q), bool),
        number=np.full((n, slots, q), -1, np.int32),
        since=np.zeros((n, slots), np.int32),
        event=np.zeros(n, bool),
        next_event=np.full(n, n, np.int32),
    )
    for s in samples:
        if s.taken <= ticks:
            out.sense[s.taken] = packet[s.taken]
            out.sampled[s.taken, s.channel] = True
            out.sample[s.taken, s.channel] = s.number
    last = 0
    for tick in sorted(by_arrival):
        for slot, (taken, group) in enumerate(sorted(by_arrival[tick].items())):
            out.arrive[tick, slot] = packet[taken]
            out.sent[tick, slot] = taken
            out.since[tick, slot] = tick - last
            for s in group:
                out.fresh[tick, slot, s.channel] = True
                out.number[tick, slot, s.channel] = s.number
        last = tick
    out.event[:] = (out.sense >= 0) | (out.arrive >= 0).any(1)
    for tick in range(ticks - 1, -1, -1):
        out.next_event[tick] = tick + 1 if out.event[tick + 1] else out.next_event[tick + 1]
    return out


def periodic(period: list[int], delay: list[int], ticks: int) -> Schedule:
    """Sample channel j every period[j] ticks from tick 0 on; each sample arrives delay[j] ticks later."""
    samples = [
        Sample(channel, i, taken, taken + late)
        for channel, (every, late) in enumerate(zip(period, delay, strict=True))
        for i, taken in enumerate(range(0, ticks + 1, every))
    ]
    return schedule(samples, ticks, len(period))


def in_flight(plan: Schedule) -> int:
    """Return how many packets the network must be able to hold so that none is overwritten before it arrives."""
    latest = np.maximum.accumulate(plan.sense)
    waiting = np.where(plan.arrive >= 0, latest[:, None] - plan.arrive + 1, 1)
    return int(waiting.max())


def pad_slots(plan: Schedule, slots: int) -> Schedule:
    """Add empty arrival slots so that schedules of one study share a shape."""
    more = slots - plan.arrive.shape[1]

    def wider(x: NDArray, fill: int) -> NDArray:
        return np.pad(x, [(0, 0), (0, more)] + [(0, 0)] * (x.ndim - 2), constant_values=fill)

    return plan._replace(
        arrive=wider(plan.arrive, -1),
        sent=wider(plan.sent, 0),
        fresh=wider(plan.fresh, 0),
        number=wider(plan.number, -1),
        since=wider(plan.since, 0),
    )
