"""A schedule of delayed samples as integer arrays: the samples taken and the packets that arrive at every tick.

All times are whole ticks. A *packet* is one sampling instant: all channels sampled at that tick share one packet number. Each
channel has its own delay, so a packet may arrive in parts. The packets that arrive at one tick are used one at a time, the
oldest first; each has a slot. If sampling is random, every run has its own schedule (`random_times`).
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.simulation.schedule.sampling import LOST, Clock, age, instants

Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]
NEVER = 2**30  # the arrival of a lost sample


class Schedule(NamedTuple):
    """N + 1 ticks, q channels, S arrival slots per tick; -1: none."""

    sense: Ints  # [N+1] the packet taken at this tick
    sample: Ints  # [N+1, q] sample number of each channel, from 0; -1: the channel is not sampled
    snapshot: Ints  # [N+1] the packet for which observers take a snapshot
    arrive: Ints  # [N+1, S] the packets that arrive
    timestamp: Ints  # [N+1, S] their assumed sampling tick
    mask: Bools  # [N+1, S, q] the channels in the arrival
    number: Ints  # [N+1, S, q] sample number of each channel
    ticks_since_arrival: Ints  # [N+1, S] ticks since the last tick at which anything arrived (from 0 before the first)
    event: Bools  # [N+1] anything taken or arriving
    next_event: Ints  # [N+1] the first later tick with an event, or N + 1
    early: Ints  # [E, q] sample number of each channel, in the packets taken before tick 0
    extra_snapshots: Ints  # [N+1, M] further packets with the same timestamp, and so the same snapshot


class Sample(NamedTuple):
    """One sample of one channel."""

    channel: int
    number: int  # sample number of the channel, from 0
    tick: int  # at which it is taken
    arrives: int  # tick, not before `tick`; NEVER: lost
    timestamp_error: int = 0  # timestamp minus `tick` [ticks]

    def assumed_tick(self, error: int) -> int:
        """Return the assumed sampling tick, `error` ticks earlier; for a sample from before tick 0 the true one."""
        return max(self.tick - error + self.timestamp_error, 0) if self.tick >= 0 else self.tick


def samples_of(clocks: list[Clock], ticks: int) -> list[Sample]:
    """Return every sample of clocks without randomness, taken up to tick `ticks`, from tick 0 or before (`Clock.early`)."""
    out = []
    for clock in clocks:
        if clock.plain:
            delay = clock.period if clock.delay is None else clock.delay
            rows = enumerate(range(0, ticks + 1, clock.period))
            out += [Sample(j, i * clock.stride, tick, tick + delay) for i, tick in rows for j in clock.channels]
            continue
        due, last = instants(clock, ticks), None
        for i, tick in enumerate(due[:-1]):
            arrives = due[i + 1] if clock.delay is None else tick + clock.delay
            if clock.delay_sequence:
                extra_delay = clock.delay_sequence[i % len(clock.delay_sequence)]
                arrives = NEVER if extra_delay == LOST else arrives + extra_delay
            if clock.early:
                tick, arrives = tick - age(clock, tick), tick
                if tick == last:  # the delay grows as fast as time: no new sample arrives
                    continue
                last = tick
            if clock.outage[0] <= tick < clock.outage[1]:
                arrives = NEVER
            offset = clock.stamp.error_at(tick)
            out += [Sample(channel, i * clock.stride, tick, arrives, offset) for channel in clock.channels]
    return out


def times_of_samples(clocks: list[Clock], ticks: int) -> NDArray[np.int64]:
    """Return (arrival tick, sampling tick, channel) of each of `samples_of`, [m, 3]; vectorized for plain clocks."""
    if not all(clock.plain for clock in clocks):
        return np.array([(s.arrives, s.tick, s.channel) for s in samples_of(clocks, ticks)], int).reshape(-1, 3)
    tables = []
    for clock in clocks:
        sampling_ticks = np.repeat(np.arange(0, ticks + 1, clock.period), len(clock.channels))
        delay = clock.period if clock.delay is None else clock.delay
        channels = np.resize(clock.channels, len(sampling_ticks))
        tables.append(np.stack([sampling_ticks + delay, sampling_ticks, channels], 1))
    return np.concatenate(tables)


def max_oosm_lag(samples: list[Sample]) -> int:
    """Return the largest number of newer samples that arrive before an older one."""
    times = np.array(
        sorted({(s.tick + s.timestamp_error, s.arrives) for s in samples if s.arrives < NEVER}), int
    ).reshape(-1, 2)
    timestamps, arrives = times.T
    counts, shift = np.zeros(len(times), int), 1
    while shift < len(times) and (timestamps[shift:] < arrives[:-shift]).any():
        counts[:-shift] += (arrives[shift:] < arrives[:-shift]) & (timestamps[shift:] > timestamps[:-shift])
        shift += 1
    return int(counts.max(initial=0))


def schedule(samples: list[Sample], ticks: int, channels: int, error: int = 0) -> Schedule:
    """Return the schedule of samples over ticks 0 .. `ticks`, without those taken or arriving later.

    - Samples taken at one tick have one timestamp.
    - Observers assume that every sample is `error` ticks older than it is, but not taken before tick 0.
    - They take a snapshot at the assumed sampling tick. A negative error must leave every age at 0 or more.
    - A sample taken before tick 0 measures the initial state.
    """
    sampling_ticks = sorted({s.tick for s in samples if s.tick <= ticks})
    packet = {tick: i for i, tick in enumerate(sampling_ticks)}
    by_arrival: dict[int, dict[int, list[Sample]]] = {}
    for s in samples:
        if s.tick <= ticks and s.arrives <= ticks:
            by_arrival.setdefault(s.arrives, {}).setdefault(s.tick, []).append(s)
    slots = max((len(group) for group in by_arrival.values()), default=1)
    timestamps = {s.tick: max(s.tick - error + s.timestamp_error, 0) for s in samples}
    snapshots = _snapshots_by_tick(samples, packet, ticks, error)
    n_early, n_extra = sum(tick < 0 for tick in sampling_ticks), max(map(len, snapshots.values()), default=1) - 1
    out = empty_schedule(ticks, channels, slots, n_early, n_extra)
    for s in samples:
        if s.tick < 0:
            out.early[packet[s.tick], s.channel] = s.number
        elif s.tick <= ticks:
            out.sense[s.tick] = packet[s.tick]
            out.sample[s.tick, s.channel] = s.number
    for tick, packets in snapshots.items():
        out.snapshot[tick], out.extra_snapshots[tick, : len(packets) - 1] = packets[0], packets[1:]
    last = 0
    for tick in sorted(by_arrival):
        for slot, (sampling_tick, group) in enumerate(sorted(by_arrival[tick].items())):
            out.arrive[tick, slot] = packet[sampling_tick]
            out.timestamp[tick, slot] = timestamps[sampling_tick]
            out.ticks_since_arrival[tick, slot] = tick - last
            for s in group:
                out.mask[tick, slot, s.channel] = True
                out.number[tick, slot, s.channel] = s.number
        last = tick
    return set_events(out)


def empty_schedule(ticks: int, channels: int, slots: int = 1, early: int = 0, extra_snapshots: int = 0) -> Schedule:
    """Return a schedule without events, with arrays of the given sizes."""
    n, q = ticks + 1, channels
    return Schedule(
        sense=np.full(n, -1, np.int32),
        sample=np.full((n, q), -1, np.int32),
        snapshot=np.full(n, -1, np.int32),
        arrive=np.full((n, slots), -1, np.int32),
        timestamp=np.zeros((n, slots), np.int32),
        mask=np.zeros((n, slots, q), bool),
        number=np.full((n, slots, q), -1, np.int32),
        ticks_since_arrival=np.zeros((n, slots), np.int32),
        event=np.zeros(n, bool),
        next_event=np.full(n, n, np.int32),
        early=np.full((early, q), -1, np.int32),
        extra_snapshots=np.full((n, extra_snapshots), -1, np.int32),
    )


def set_events(out: Schedule) -> Schedule:
    """Set `event` and `next_event` from the other arrays."""
    n = len(out.event)
    out.event[:] = (out.sense >= 0) | (out.snapshot >= 0) | (out.arrive >= 0).any(1)
    due = np.where(out.event, np.arange(n, dtype=np.int32), np.int32(n))
    out.next_event[:-1] = np.minimum.accumulate(due[::-1])[::-1][1:]
    return out


def plain_clock(clock: Clock, ticks: int, channels: int) -> tuple[Schedule, int]:
    """Return the `schedule` of one plain clock with a correct timestamp, and the packets `in_flight`; without Python loops.

    All delays of a period share one cached table. A delay shifts its arrivals.
    """
    n, delay = ticks + 1, clock.period if clock.delay is None else clock.delay
    undelayed = _undelayed(clock.period, clock.stride, clock.channels, ticks, channels)
    rows = slice(n - min(delay, n), 2 * n - min(delay, n))
    since = undelayed.ticks_since_arrival[rows].copy()
    if delay <= ticks:
        since[delay, 0] = delay
    out = undelayed._replace(
        arrive=undelayed.arrive[rows],
        timestamp=undelayed.timestamp[rows],
        mask=undelayed.mask[rows],
        number=undelayed.number[rows],
        ticks_since_arrival=since,
        event=np.zeros(n, bool),
        next_event=np.full(n, n, np.int32),
    )
    return set_events(out), 1 + delay // clock.period * (delay <= ticks)


@lru_cache(16)
def _undelayed(period: int, stride: int, clock_channels: tuple[int, ...], ticks: int, channels: int) -> Schedule:
    """Return the schedule of a plain clock without a delay, its arrivals preceded by N + 1 empty rows, [2 (N + 1)]."""
    n, q = ticks + 1, list(clock_channels)
    sampling_ticks = np.arange(0, n, period, dtype=np.int32)
    packet, rows = np.arange(len(sampling_ticks), dtype=np.int32), n + sampling_ticks
    number = packet * np.int32(stride)
    sampling, arrivals = empty_schedule(ticks, channels), empty_schedule(2 * n - 1, channels)
    sampling.sense[sampling_ticks] = sampling.snapshot[sampling_ticks] = packet
    sampling.sample[sampling_ticks[:, None], q] = number[:, None]
    arrivals.arrive[rows, 0], arrivals.timestamp[rows, 0] = packet, sampling_ticks
    arrivals.ticks_since_arrival[rows, 0] = np.diff(sampling_ticks, prepend=0)
    arrivals.mask[rows[:, None], 0, q] = True
    arrivals.number[rows[:, None], 0, q] = number[:, None]
    result = arrivals._replace(
        sense=sampling.sense,
        sample=sampling.sample,
        snapshot=sampling.snapshot,
        early=sampling.early,
        extra_snapshots=sampling.extra_snapshots,
    )
    for table in result:
        table.flags.writeable = False  # read-only: many schedules have views of it
    return result


def every_tick_schedule(ticks: int, channels: int) -> Schedule:
    """Return the schedule of all channels at every tick without a delay: `schedule` of period 1 and delay 0, vectorized."""
    k = np.arange(ticks + 1, dtype=np.int32)
    row, numbers = k[:, None], np.repeat(k[:, None], channels, 1)
    return Schedule(
        sense=k,
        sample=numbers,
        snapshot=k,
        arrive=row,
        timestamp=row,
        mask=np.ones((ticks + 1, 1, channels), bool),
        number=numbers[:, None],
        ticks_since_arrival=np.minimum(row, 1),
        event=np.ones(ticks + 1, bool),
        next_event=k + np.int32(1),
        early=numbers[:0],
        extra_snapshots=np.zeros((ticks + 1, 0), np.int32),
    )


def _snapshots_by_tick(samples: list[Sample], packet: dict[int, int], ticks: int, error: int) -> dict[int, list[int]]:
    """Return the packets for which observers take a snapshot, by tick."""
    out: dict[int, set[int]] = {}
    for s in samples:
        if s.tick <= ticks and 0 <= s.tick - error + s.timestamp_error <= ticks:
            out.setdefault(s.tick - error + s.timestamp_error, set()).add(packet[s.tick])
    return {tick: sorted(packets) for tick, packets in out.items()}


def periodic(period: list[int], delay: list[int], ticks: int) -> Schedule:
    """Return the schedule of channels j sampled every period[j] ticks from tick 0 on, each delayed by delay[j] ticks."""
    clocks = [Clock((j,), interval, lag) for j, (interval, lag) in enumerate(zip(period, delay, strict=True))]
    return schedule(samples_of(clocks, ticks), ticks, len(period))


def max_input_age(samples: list[Sample], oosm_lag: int) -> int:
    """Return the largest age [ticks] of an input that an observer may need.

    For sample i in sampling order: the latest arrival of samples 0 .. i, minus the sampling tick of sample i - (2 K + 1), with
    K = `max_oosm_lag`. The result is the maximum over i.
    """
    times = np.array(
        sorted({(max(s.tick + min(s.timestamp_error, 0), 0), s.arrives) for s in samples if s.arrives < NEVER}), int
    ).reshape(-1, 2)
    timestamps, arrives = times.T
    back = 2 * oosm_lag + 1
    previous = np.concatenate([np.zeros(back, int), timestamps])[: len(timestamps)]
    return int((np.maximum.accumulate(arrives) - previous).max(initial=0))


def in_flight(plan: Schedule) -> int:
    """Return how many packets the network must hold so that none is overwritten before it arrives."""
    snapshots = np.concatenate([plan.snapshot[:, None], plan.extra_snapshots], 1)
    latest = np.maximum(np.maximum.accumulate(np.maximum(plan.sense, snapshots.max(1))), len(plan.early) - 1)
    counts = np.where(plan.arrive >= 0, latest[:, None] - plan.arrive + 1, 1)
    return max([int(counts.max()), *(newer - number + 1 for newer, number in _written_over(plan, snapshots))])


def _written_over(plan: Schedule, snapshots: Ints) -> Iterator[tuple[int, int]]:
    """Yield (newest packet not yet arrived, older packet) whenever a snapshot of the older packet is taken later."""
    newest = np.append(-1, np.maximum.accumulate(snapshots.max(1))[:-1])[:, None]
    older = (snapshots >= 0) & (snapshots < newest)
    if not older.any():
        return
    first, last = (np.full(len(plan.sense) + len(plan.early), fill) for fill in (NEVER, -1))
    np.maximum.at(last, plan.arrive[plan.arrive >= 0], np.nonzero(plan.arrive >= 0)[0])
    np.minimum.at(first, snapshots[snapshots >= 0], np.nonzero(snapshots >= 0)[0])
    for k, number in zip(np.nonzero(older)[0], snapshots[older], strict=True):
        pending = np.flatnonzero((first < k) & (last >= k))
        if pending.size and pending[-1] > number:
            yield int(pending[-1]), int(number)


def pad_early(plan: Schedule, packets: int) -> Schedule:
    """Pad with unused packets from before tick 0, so that schedules of one study have one shape."""
    if packets == len(plan.early):
        return plan
    return plan._replace(early=np.pad(plan.early, [(0, packets - len(plan.early)), (0, 0)], constant_values=-1))


def pad_snapshots(plan: Schedule, count: int) -> Schedule:
    """Pad the snapshots of each tick, so that schedules of one study have one shape."""
    n_missing = count - plan.extra_snapshots.shape[1]
    if not n_missing:
        return plan
    return plan._replace(extra_snapshots=np.pad(plan.extra_snapshots, [(0, 0), (0, n_missing)], constant_values=-1))


def pad_slots(plan: Schedule, slots: int) -> Schedule:
    """Pad with empty arrival slots, so that schedules of one study have one shape."""
    extra = slots - plan.arrive.shape[1]
    if not extra:
        return plan

    def pad(x: NDArray, fill: int) -> NDArray:
        return np.pad(x, [(0, 0), (0, extra)] + [(0, 0)] * (x.ndim - 2), constant_values=fill)

    return plan._replace(
        arrive=pad(plan.arrive, -1),
        timestamp=pad(plan.timestamp, 0),
        mask=pad(plan.mask, 0),
        number=pad(plan.number, -1),
        ticks_since_arrival=pad(plan.ticks_since_arrival, 0),
    )
