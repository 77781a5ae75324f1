"""A recording's samples in ticks, block by block, as `schedule.common_times.schedule` returns them for a run, with values.

A block of ticks contains all samples taken or arriving in it. Rows may be in any order. A block is complete once a row is read
whose timestamp is later than its end by the largest lag of any row (`Survey.behind`). `Room` has the sizes that a recording
needs: slots, packets in flight, out-of-sequence samples, ages.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.recordings.log import Floats, Ints, Log
from pcbench.recordings.survey import Survey
from pcbench.recordings.times import NEVER, Clock, require_sound

Ticks = NDArray[np.int32]


class Block(NamedTuple):
    """Ticks first .. end - 1 of a log.

    Columns of samples: channel, taken [tick], arrives [tick] (not before taken; NEVER: lost), value, row, std (of the noise;
    NaN: not stated), number (of the sample in its channel, from 0) and packet (sampling instant, from 0).
    """

    first: int
    end: int
    samples: pd.DataFrame  # taken in the block, in sampling order, at one tick in the order of channels
    arrivals: pd.DataFrame  # arriving in the block, by tick of arrival, then of sampling, then by channel


class Window(NamedTuple):
    """K ticks, q channels, S arrival slots; -1: none."""

    sense: Ticks  # [K] the packet taken at this tick
    sampled: NDArray[np.bool_]  # [K, q] the channels in it
    arrive: Ticks  # [K, S] the packets that arrive
    sampling_ticks: Ticks  # [K, S] their sampling ticks
    mask: NDArray[np.bool_]  # [K, S, q]
    number: Ticks  # [K, S, q] sample number of each channel
    value: Floats  # [K, S, q]
    ticks_since_arrival: Ticks  # [K, S] ticks since the last tick at which anything arrived (from 0 before the first)
    event: NDArray[np.bool_]  # [K]
    variance_ratio: Floats | None = None  # [K, S, q] as in `protocols.Arrival`


class Room(NamedTuple):
    """The room that a recording needs; ticks."""

    slots: int = 1  # packets that arrive at one tick
    flight: int = 1  # packets in flight, including the one taken now
    oosm_lag: int = 0  # newer packets that arrive before an older one
    latest: int = 0  # largest age at arrival
    longest_gap: int = 0  # longest time from one packet to the next
    longest_gap_row: int = 0  # row of the latter
    recent: Ints = np.zeros((0, 3), np.int64)  # (taken, arrives, packet) of packets that matter for the next block
    newest: int = 0  # tick at which the last packet was taken


def cut(parts: Iterator[pd.DataFrame], length: int, last: int, behind: int = 0) -> Iterator[tuple[int, pd.DataFrame]]:
    """Yield the first tick of every `length` ticks up to `last`, and the rows of that time, in order.

    The index of the parts (at least one) is their ticks, none below 0. A row may be `behind` ticks behind an earlier row.
    """
    pending = [next(parts)]
    newest = pending[0].index.max()
    for first in range(0, last + 1, length):
        while not newest - behind >= first + length and (part := next(parts, None)) is not None:
            pending.append(part)
            newest = np.fmax(newest, part.index.max())
        rows = pd.concat(pending)
        in_block = rows.index < first + length
        pending = [rows[~in_block]]
        yield first, rows[in_block]


def blocks(log: Log, survey: Survey, clock: Clock, length: int, last: int) -> Iterator[Block]:
    """Yield a log in blocks of `length` ticks, the last one with tick `last` in it.

    Raises UserError if two samples of a channel are at one tick. Samples taken before tick 0 or after `last` are left out.
    """

    def parts() -> Iterator[pd.DataFrame]:
        for batch in log.measurements():
            if len(batch.row):
                require_sound(log, batch)
                columns = {"channel": batch.channel, "arrives": clock.ticks(batch.arrived), "value": batch.value}
                ticks = clock.ticks(batch.sampled)
                std = batch.std if len(batch.std) else np.full(len(ticks), np.nan)
                part = pd.DataFrame(columns | {"std": std, "row": batch.row, "taken": ticks}, index=ticks)
                yield part[(ticks >= 0) & (ticks <= last)]

    n_samples, n_packets, in_flight = np.zeros(len(log.channels), np.int64), 0, None
    for first, rows in cut(parts(), length, last, int(survey.behind / clock.dt) + 2):
        end, samples = first + length, rows.sort_values(["taken", "channel"], kind="stable")
        is_duplicate = samples.duplicated(["taken", "channel"]).to_numpy()
        if is_duplicate.any():
            before, sample = (samples.iloc[int(np.argmax(is_duplicate)) - step] for step in (1, 0))
            raise UserError(
                f"{log.name}: row {sample.row:.0f} of channel {log.channels[int(sample.channel)]}: got a sample on the same "
                f"tick of {clock.dt:g} s as row {before.row:.0f}, expected one at most; remove the repeated sample, or use "
                "a shorter tick."
            )
        number = n_samples[samples.channel] + samples.groupby("channel").cumcount()
        packet = n_packets - 1 + (samples.taken.diff() != 0).cumsum()
        samples = samples.assign(number=number, packet=packet)
        n_samples += np.bincount(samples.channel, minlength=len(n_samples))
        n_packets += samples.taken.nunique()
        in_flight = samples if in_flight is None else pd.concat([in_flight, samples])
        has_arrived = in_flight.arrives < end
        arrivals = in_flight[has_arrived].sort_values(["arrives", "taken", "channel"], kind="stable")
        in_flight = in_flight[~has_arrived & (in_flight.arrives < NEVER)]
        yield Block(first, end, samples, arrivals)


def window(
    s: Block, channels: int, slots: int, last_arrival: int, variances: Floats | None = None
) -> tuple[Window, int]:
    """Return the window of a block, and the last tick with an arrival, given the previous one.

    `variances` [q] are the assumed noise variances, for a log that states the noise of its samples.
    """
    n_ticks, shape = s.end - s.first, (s.end - s.first, slots)
    out = Window(
        sense=np.full(n_ticks, -1, np.int32),
        sampled=np.zeros((n_ticks, channels), bool),
        arrive=np.full(shape, -1, np.int32),
        sampling_ticks=np.zeros(shape, np.int32),
        mask=np.zeros((*shape, channels), bool),
        number=np.full((*shape, channels), -1, np.int32),
        value=np.zeros((*shape, channels)),
        ticks_since_arrival=np.zeros(shape, np.int32),
        event=np.zeros(n_ticks, bool),
    )
    out.sense[s.samples.taken - s.first] = s.samples.packet
    out.sampled[s.samples.taken - s.first, s.samples.channel] = True
    tick, slot, channel = s.arrivals.arrives - s.first, slots_of(s), s.arrivals.channel
    out.arrive[tick, slot] = s.arrivals.packet
    out.sampling_ticks[tick, slot] = s.arrivals.taken
    out.mask[tick, slot, channel] = True
    out.number[tick, slot, channel] = s.arrivals.number
    out.value[tick, slot, channel] = s.arrivals.value
    if variances is not None:
        sample_ratio, ratio = np.square(s.arrivals["std"]) / variances[channel], np.ones((*shape, channels))
        ratio[tick, slot, channel] = np.where(np.isnan(sample_ratio), 1.0, sample_ratio)
        out = out._replace(variance_ratio=ratio)
    arrival_ticks, index = np.unique(s.arrivals.arrives, return_inverse=True)
    out.ticks_since_arrival[tick, slot] = np.diff(arrival_ticks, prepend=last_arrival)[index]
    out.event[:] = (out.sense >= 0) | (out.arrive >= 0).any(1)
    return out, int(arrival_ticks[-1]) if arrival_ticks.size else last_arrival


def slots_of(s: Block) -> Ints:
    """Return the slot of every sample that arrives in a block: samples of one packet share a slot, the oldest is first."""
    by_tick = s.arrivals.groupby("arrives").packet
    return (by_tick.rank("dense") - 1).to_numpy(np.int64)


def with_block(room: Room, s: Block, latest: int) -> Room:
    """Return the room after one more block; `latest` bounds the age [ticks] of all samples of the log."""
    in_flight = s.samples[s.samples.arrives < NEVER][["taken", "arrives", "packet"]].to_numpy()
    packets = np.unique(np.concatenate([room.recent, in_flight]), axis=0)
    sampling, arrival, packet = packets.T
    first = s.samples.drop_duplicates("taken")  # one sample per packet
    gaps = np.diff(first.taken, prepend=room.newest)
    is_longer = int(gaps.max(initial=0)) > room.longest_gap
    # from each packet to the newest taken by the time it arrives, inclusive
    place = np.searchsorted(first.taken, arrival, side="right") - 1
    by_then = np.where(place >= 0, first.packet.to_numpy()[place], packet) if len(first) else packet
    # newer packets that arrive before an older one, as `common_times.max_oosm_lag`
    oosm_lag, shift = np.zeros(len(packets), int), 1
    while shift < len(packets) and (sampling[shift:] < arrival[:-shift]).any():
        oosm_lag[:-shift] += (arrival[shift:] < arrival[:-shift]) & (sampling[shift:] > sampling[:-shift])
        shift += 1
    return Room(
        slots=max(room.slots, int(slots_of(s).max(initial=0)) + 1),
        flight=max(room.flight, int((by_then - packet).max(initial=0)) + 1),
        oosm_lag=max(room.oosm_lag, int(oosm_lag.max(initial=0))),
        latest=max(room.latest, int((arrival - sampling).max(initial=0))),
        longest_gap=max(room.longest_gap, int(gaps.max(initial=0))),
        longest_gap_row=int(first.row.iloc[np.argmax(gaps)]) if is_longer else room.longest_gap_row,
        recent=packets[sampling >= s.end - 1 - latest],
        newest=int(first.taken.iloc[-1]) if len(first) else room.newest,
    )
