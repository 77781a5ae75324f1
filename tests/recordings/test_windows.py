"""A log laid out over ticks is the schedule of the run with those samples, however it is cut, in whatever order it stands."""

import numpy as np
import pytest
from logged import log_of

from pcbench.errors import UserError
from pcbench.recordings.survey import survey
from pcbench.recordings.times import Clock, better_dt, rounding
from pcbench.recordings.windows import Room, blocks, window, with_block
from pcbench.simulation.schedule import common_times

TICKS, CHANNELS = 120, 2
CLOCK = Clock(0.0, 1.0)


def draw_samples(seed):
    """Two channels at 3 and 5 ticks, 0 to 30 late, every sixth lost; as samples of a log and of a schedule."""
    rng = np.random.default_rng(seed)
    out, scheduled = [], []
    for channel, every in enumerate((3, 5)):
        for number, taken in enumerate(range(0, TICKS + 1, every)):
            arrives = None if rng.random() < 0.17 else taken + int(rng.integers(0, 31))
            out.append((channel, taken, arrives))
            scheduled.append(
                common_times.Sample(channel, number, taken, common_times.NEVER if arrives is None else arrives)
            )
    return out, scheduled


def laid(log, found, length, slots):
    parts, arrived = [], 0
    for block in blocks(log, found, CLOCK, length, TICKS):
        part, arrived = window(block, CHANNELS, slots, arrived)
        assert part.variance_ratio is None  # the log states no noise of its own
        parts.append(part[:-1])
    return [np.concatenate(columns)[: TICKS + 1] for columns in zip(*parts, strict=True)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("length", [4, 16, 200])
@pytest.mark.parametrize("order", ["arrival", "taking", "any"])
def test_windows_are_the_schedule_of_the_same_samples(seed, length, order):
    samples, scheduled = draw_samples(seed)
    rng = np.random.default_rng(99)
    places = {
        "arrival": sorted(range(len(samples)), key=lambda i: (samples[i][2] or 10**6, i)),
        "taking": sorted(range(len(samples)), key=lambda i: samples[i][1]),
        "any": rng.permutation(len(samples)).tolist(),
    }[order]
    log = log_of(samples, order=places)
    want = common_times.schedule(scheduled, TICKS, CHANNELS)
    sense, sampled, arrive, taken, mask, number, value, ticks_since_arrival, event = laid(
        log, survey(log), length, want.arrive.shape[1]
    )
    np.testing.assert_array_equal(sense, want.sense)
    np.testing.assert_array_equal(sampled, want.sample >= 0)
    np.testing.assert_array_equal(arrive, want.arrive)
    np.testing.assert_array_equal(taken, want.timestamp)
    np.testing.assert_array_equal(mask, want.mask)
    np.testing.assert_array_equal(number, want.number)
    np.testing.assert_array_equal(ticks_since_arrival, want.ticks_since_arrival)
    np.testing.assert_array_equal(event, want.event)
    at = {(c, t): float(i) for i, (c, t, _) in enumerate(samples)}
    k, slot, channel = np.nonzero(mask)
    assert value[k, slot, channel].tolist() == [at[c, t] for c, t in zip(channel, taken[k, slot], strict=True)]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("length", [4, 16, 200])
def test_the_room_of_a_log_is_that_of_the_schedule(seed, length):
    samples, scheduled = draw_samples(seed)
    log, room = log_of(samples), Room()
    for block in blocks(log, survey(log), CLOCK, length, TICKS):
        room = with_block(room, block, 31)
    there = [s for s in scheduled if s.arrives < common_times.NEVER]
    assert room.slots == common_times.schedule(scheduled, TICKS, CHANNELS).arrive.shape[1]
    assert room.oosm_lag == common_times.max_oosm_lag(there)
    assert room.flight >= common_times.in_flight(common_times.schedule(scheduled, TICKS, CHANNELS))
    assert room.flight <= 31
    assert room.latest == max(s.arrives - s.tick for s in there)
    assert room.longest_gap == np.diff(sorted({s.tick for s in scheduled})).max()


def test_two_samples_of_a_channel_on_one_tick_are_one_sentence_with_both_rows():
    log = log_of([(0, 1.0, 2), (0, 5.2, 7), (0, 4.9, 7)], channels=1)
    with pytest.raises(UserError, match=r"row 3 of channel y1: got a sample on the same tick of 1 s as row 2"):
        list(blocks(log, survey(log), CLOCK, 50, 20))


def test_times_are_rounded_to_the_nearest_tick_and_the_largest_rounding_is_known():
    times = np.array([0.5, 0.6124, np.nan])
    found = Clock(0.5, 0.1).ticks(times)
    assert found[:2].tolist() == [0, 1]
    assert found[2] > 2**39
    assert rounding(times[:2] - 0.5, 0.1) == pytest.approx(0.0124)


def test_a_tick_is_proposed_that_stamps_lie_on_or_that_is_short():
    on_a_grid = np.arange(50) * 0.025
    assert better_dt(on_a_grid, 0.025, 0.025) is None
    assert better_dt(on_a_grid, 0.01, 0.025) == pytest.approx(0.00625)
    anywhere = np.random.default_rng(2).uniform(0, 5, 300)
    assert better_dt(anywhere, 0.01, 0.02) <= 2 * 0.01 * 0.02
