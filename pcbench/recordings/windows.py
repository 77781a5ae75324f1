"""A stretch of a log as arrays over its ticks: what `schedule.common_times.schedule` lays out for a run, with values.

And the room that a log needs: slots, packets on their way, samples that overtake, ages.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.recordings.events import Samples, Stretch
from pcbench.recordings.log import Floats
from pcbench.recordings.ticks import NEVER

Whole = NDArray[np.int32]


class Window(NamedTuple):
    """K ticks, q channels, S arrival slots; -1 means nothing."""

    sense: Whole  # [K] the packet taken at this tick
    sampled: NDArray[np.bool_]  # [K, q] the channels in it
    arrive: Whole  # [K, S] the packets that arrive
    taken: Whole  # [K, S] the tick at which it was taken
    mask: NDArray[np.bool_]  # [K, S, q]
    number: Whole  # [K, S, q] which sample of its channel
    value: Floats  # [K, S, q]
    ticks_since_arrival: Whole  # [K, S] ticks since the last tick at which anything arrived (from 0 before the first)
    event: NDArray[np.bool_]  # [K]


class Room(NamedTuple):
    """What a log needs room for; ticks."""

    slots: int = 1  # packets that arrive at one tick
    flight: int = 1  # packets on their way, the one that is taken now too
    overtaking: int = 0  # newer packets that arrive before one
    latest: int = 0  # the greatest age at arrival
    apart: int = 0  # the longest time from one packet to the next,
    apart_row: int = 0  # and a row of the latter


def window(s: Stretch, channels: int, slots: int, last_arrival: int) -> tuple[Window, int]:
    """Lay a stretch out; return it, and the last tick at which anything arrived, given that of before."""
    many, coming = s.end - s.first, s.arriving
    out = Window(
        sense=np.full(many, -1, np.int32),
        sampled=np.zeros((many, channels), bool),
        arrive=np.full((many, slots), -1, np.int32),
        taken=np.zeros((many, slots), np.int32),
        mask=np.zeros((many, slots, channels), bool),
        number=np.full((many, slots, channels), -1, np.int32),
        value=np.zeros((many, slots, channels)),
        ticks_since_arrival=np.zeros((many, slots), np.int32),
        event=np.zeros(many, bool),
    )
    at = s.taken.taken - s.first
    out.sense[at] = s.taken.packet
    out.sampled[at, s.taken.channel] = True
    tick, slot = coming.arrives - s.first, slots_of(coming)
    out.arrive[tick, slot] = coming.packet
    out.taken[tick, slot] = coming.taken
    out.mask[tick, slot, coming.channel] = True
    out.number[tick, slot, coming.channel] = coming.number
    out.value[tick, slot, coming.channel] = coming.value
    when = np.unique(coming.arrives)
    ticks_since_arrival = np.diff(when, prepend=last_arrival)
    out.ticks_since_arrival[tick, slot] = ticks_since_arrival[np.searchsorted(when, coming.arrives)]
    out.event[:] = (out.sense >= 0) | (out.arrive >= 0).any(1)
    return out, int(when[-1]) if when.size else last_arrival


def slots_of(coming: Samples) -> NDArray[np.int64]:
    """Return the slot of every sample of a stretch that arrives: those of one packet share one, the oldest has the first."""
    if not len(coming.arrives):
        return np.zeros(0, np.int64)
    new_tick = np.diff(coming.arrives, prepend=-1) != 0
    new_packet = new_tick | (np.diff(coming.packet, prepend=-1) != 0)
    packet = np.cumsum(new_packet) - 1
    return packet - np.maximum.accumulate(np.where(new_tick, packet, 0))


class Tally(NamedTuple):
    """The room so far, and what the next stretch's depends on."""

    room: Room = Room()
    before: NDArray[np.int64] = np.zeros((0, 3), np.int64)  # (taken, arrives, packet) of packets that matter yet
    newest: int = -1  # the tick at which the last packet was taken


def tally(so_far: Tally, s: Stretch, latest: int) -> Tally:
    """Return the room with one stretch more; `latest` bounds the age [ticks] of all samples of the log."""
    room, taken = so_far.room, s.taken
    mine = np.stack([taken.taken, taken.arrives, taken.packet], 1)[taken.arrives < NEVER]
    each = np.unique(np.concatenate([so_far.before, mine]), axis=0)
    instants, first = np.unique(taken.taken, return_index=True)
    apart = np.diff(instants, prepend=max(so_far.newest, 0))
    further = int(apart.max(initial=0)) > room.apart
    newest = int(taken.packet[-1]) if len(taken.packet) else -1
    there = each[each[:, 2] >= 0]
    waiting = _waiting(there, taken, newest)
    return Tally(
        Room(
            slots=max(room.slots, int(slots_of(s.arriving).max(initial=0)) + 1),
            flight=max(room.flight, waiting),
            overtaking=max(room.overtaking, _overtaken(each)),
            latest=max(room.latest, int((each[:, 1] - each[:, 0]).max(initial=0))),
            apart=max(room.apart, int(apart.max(initial=0))),
            apart_row=int(taken.row[first[np.argmax(apart)]]) if further else room.apart_row,
        ),
        each[each[:, 0] >= s.end - 1 - latest],
        int(taken.taken[-1]) if len(taken.taken) else so_far.newest,
    )


def _waiting(each: NDArray[np.int64], taken: Samples, newest: int) -> int:
    """The most packets from one to the newest that is taken by the time that it arrives, both counted."""
    if not len(each):
        return 1
    instants, first = np.unique(taken.taken, return_index=True)
    numbers = taken.packet[first]
    place = np.searchsorted(instants, each[:, 1], side="right") - 1
    by_then = np.where(place >= 0, numbers[np.maximum(place, 0)] if len(numbers) else newest, each[:, 2])
    return int((by_then - each[:, 2]).max()) + 1


def _overtaken(each: NDArray[np.int64]) -> int:
    """As `common_times.overtaking`: the most packets taken after one that arrive before it; of rows sorted by `taken`."""
    taken, arrives = each[:, 0], each[:, 1]
    counts, shift = np.zeros(len(each), int), 1
    while shift < len(each) and (taken[shift:] < arrives[:-shift]).any():
        counts[:-shift] += (arrives[shift:] < arrives[:-shift]) & (taken[shift:] > taken[:-shift])
        shift += 1
    return int(counts.max(initial=0))
