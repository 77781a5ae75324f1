"""The schedule says exactly which sample is taken and which arrives at every tick."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcbench.simulation.schedule import common_times, sampling
from pcbench.simulation.schedule.common_times import Sample, in_flight, pad_slots, periodic, schedule

channels = st.integers(1, 3)


def sampling_tick(plan, tick, slot):
    """The tick at which what arrives was taken."""
    return np.flatnonzero(plan.sense == plan.arrive[tick, slot])[0]


def arrivals(plan):
    """(tick, channel, index, taken) of everything that arrives, in order of delivery."""
    return [
        (tick, j, int(plan.number[tick, slot, j]), int(sampling_tick(plan, tick, slot)))
        for tick in range(len(plan.sense))
        for slot in range(plan.arrive.shape[1])
        if plan.arrive[tick, slot] >= 0
        for j in range(plan.mask.shape[2])
        if plan.mask[tick, slot, j]
    ]


@settings(max_examples=60)
@given(data=st.data(), q=channels, ticks=st.integers(1, 120))
def test_every_sample_arrives_once_at_its_tick_with_its_age(data, q, ticks):
    period = data.draw(st.lists(st.integers(1, 40), min_size=q, max_size=q))
    delay = data.draw(st.lists(st.integers(0, 90), min_size=q, max_size=q))
    plan = periodic(period, delay, ticks)
    want = {
        (i * te + d, j, i, i * te)
        for j, (te, d) in enumerate(zip(period, delay, strict=True))
        for i in range(ticks // te + 1)
        if i * te + d <= ticks
    }
    got = arrivals(plan)
    assert len(got) == len(set(got)), "delivered twice"
    assert set(got) == want


@settings(max_examples=60)
@given(data=st.data(), ticks=st.integers(5, 60))
def test_late_together_and_out_of_order_samples_are_delivered_oldest_first(data, ticks):
    taken = data.draw(st.lists(st.integers(0, ticks), unique=True, min_size=1, max_size=12))
    late = data.draw(st.lists(st.integers(0, 20), min_size=len(taken), max_size=len(taken)))
    samples = [Sample(0, i, t, t + d) for i, (t, d) in enumerate(zip(sorted(taken), late, strict=True))]
    plan = schedule(samples, ticks, 1)
    assert set(arrivals(plan)) == {(s.arrives, 0, s.number, s.tick) for s in samples if s.arrives <= ticks}
    for tick in range(ticks + 1):
        taken = [sampling_tick(plan, tick, slot) for slot in np.flatnonzero(plan.arrive[tick] >= 0)]
        assert (np.diff(taken) > 0).all()


@settings(max_examples=60)
@given(data=st.data(), q=channels)
def test_a_ring_of_that_many_packets_never_overwrites_one_in_flight(data, q):
    ticks = 150
    period = data.draw(st.lists(st.integers(1, 20), min_size=q, max_size=q))
    delay = data.draw(st.lists(st.integers(0, 60), min_size=q, max_size=q))
    plan = periodic(period, delay, ticks)
    size, ring = in_flight(plan), {}
    for tick in range(ticks + 1):
        if plan.sense[tick] >= 0:
            ring[plan.sense[tick] % size] = plan.sense[tick]
        for packet in plan.arrive[tick][plan.arrive[tick] >= 0]:
            assert ring[packet % size] == packet


def test_one_slot_less_than_needed_would_overwrite():
    plan = periodic([1], [10], 50)
    assert in_flight(plan) == 11  # at a tick ten earlier packets wait beside the newest


def test_next_event_and_since_count_from_the_definition():
    plan = periodic([7], [10], 40)
    events = [k for k in range(41) if k % 7 == 0 or (k >= 10 and (k - 10) % 7 == 0)]
    assert np.flatnonzero(plan.event).tolist() == events
    assert plan.next_event.tolist() == [next((e for e in events if e > k), 41) for k in range(41)]
    assert [int(plan.ticks_since_arrival[k, 0]) for k in (10, 17, 24)] == [10, 7, 7]


@settings(max_examples=60, deadline=None)
@given(data=st.data(), ticks=st.integers(5, 60), error=st.integers(-5, 25))
def test_samples_are_believed_and_noted_so_much_earlier_but_never_before_tick_0(data, ticks, error):
    taken = data.draw(st.lists(st.integers(-20, ticks), unique=True, min_size=1, max_size=12))
    late = data.draw(st.lists(st.integers(5, 30), min_size=len(taken), max_size=len(taken)))
    samples = [Sample(0, i, t, max(t, 0) + d) for i, (t, d) in enumerate(zip(sorted(taken), late, strict=True))]
    plan, packets = schedule(samples, ticks, 1, error), {}
    for s in samples:
        if s.tick <= ticks:
            packets[s.tick] = len(packets)
    timestamp = {
        (tick, int(plan.arrive[tick, slot])): int(plan.timestamp[tick, slot])
        for tick, slot in zip(*np.nonzero(plan.arrive >= 0), strict=True)
    }
    inside = [s for s in samples if s.tick <= ticks]
    assert timestamp == {(s.arrives, packets[s.tick]): max(s.tick - error, 0) for s in inside if s.arrives <= ticks}
    noted = {s.tick - error: packets[s.tick] for s in inside if 0 <= s.tick - error <= ticks}
    assert {k: int(plan.snapshot[k]) for k in range(ticks + 1) if plan.snapshot[k] >= 0} == noted
    sensed = {s.tick: packets[s.tick] for s in inside if s.tick >= 0}
    assert {k: int(plan.sense[k]) for k in range(ticks + 1) if plan.sense[k] >= 0} == sensed
    assert plan.early.ravel().tolist() == [s.number for s in inside if s.tick < 0]


def test_padding_adds_only_empty_slots():
    plan = periodic([5, 3], [4, 4], 30)
    assert arrivals(pad_slots(plan, 4)) == arrivals(plan)


@pytest.mark.parametrize("channels", [1, 3])
def test_at_every_tick_is_the_schedule_of_period_one_and_delay_zero(channels):
    fast, slow = (
        common_times.every_tick_schedule(50, channels),
        common_times.periodic([1] * channels, [0] * channels, 50),
    )
    for name, a, b in zip(fast._fields, fast, slow, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)
        assert a.dtype == b.dtype, name
    assert common_times.in_flight(slow) == 1


@given(st.integers(1, 40), st.none() | st.integers(0, 90), st.integers(1, 120), st.sampled_from(((0,), (0, 1), (2, 0))))
def test_a_plain_clock_alone_is_laid_out_without_loops_as_its_samples_are(period, delay, ticks, channels):
    clock = sampling.Clock(channels, period, delay)
    in_turn = clock._replace(delay_sequence=(0,))  # late by nothing in turn: the same samples, one by one
    assert clock.plain
    assert not in_turn.plain
    each = common_times.samples_of([in_turn], ticks)
    assert common_times.samples_of([clock], ticks) == each
    (fast, many), slow = common_times.plain_clock(clock, ticks, 3), schedule(each, ticks, 3)
    for name, a, b in zip(common_times.Schedule._fields, fast, slow, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name, strict=True)
    assert many == in_flight(slow)
    times = sorted((s.arrives, s.tick, s.channel) for s in each)
    assert sorted(map(tuple, common_times.times_of_samples([clock], ticks).tolist())) == times
    assert sorted(map(tuple, common_times.times_of_samples([in_turn], ticks).tolist())) == times


@given(st.integers(1, 40), st.integers(0, 50), st.integers(0, 120), st.sampled_from(("periodic", "uniform")))
def test_instants_of_a_period_go_from_the_phase_to_the_first_beyond_the_horizon(period, phase, ticks, profile):
    due = sampling.instants(sampling.Clock((0,), period, 0, profile, phase=phase), ticks)
    assert due[0] == phase
    assert set(np.diff(due)) <= {period}
    assert due[-1] > ticks
    assert all(tick <= ticks for tick in due[:-1])


def test_intervals_in_turn_come_in_their_turn_and_a_sine_as_it_swings():
    turn, sine = sampling.Clock((0,), 9, 3, (5, 8, 6)), sampling.Clock((0,), 20, 3, "sine")
    assert sampling.instants(turn, 40) == [0, 5, 13, 19, 24, 32, 38, 43]
    intervals = [round(20 * (1 + 0.5 * np.sin(0.6 * i))) for i in range(1, 6)]
    assert sampling.instants(sine, 200)[:6] == [0, *np.cumsum(intervals)]
    assert sampling.intervals(turn, 40) == [5, 6, 8]


@pytest.mark.parametrize("period", [1, 7, 50, 80])
def test_intervals_of_a_periodic_clock_are_its_period(period):
    clock = sampling.Clock((0,), period, 3)
    assert sampling.intervals(clock, 50) == sorted(set(np.diff(sampling.instants(clock, 50)).tolist()))
