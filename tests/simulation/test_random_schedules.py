"""Random sampling against loops over the same draws: who is taken, lost, late, together; and what is claimed of all draws.

Any one or two clocks: every profile, delays of their own or of one interval, jitter below half the shortest interval, jitter
of the delay, loss, by itself or in bursts, stamps that are wrong, and a delay that observers misjudge. Everything is whole
ticks, so every comparison is exact.
"""

from collections import Counter
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drawn_clocks import (
    AGENDA,
    CLOCK_TIMES,
    LONGEST,
    ROOM,
    SEEDS,
    TIMES,
    ahead,
    any_clocks,
    delay_errors,
    draw_samples,
    every_sample,
    one_clock,
    roomy,
    seed_of,
    ticks_of,
    width,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pcbench.errors import UserError
from pcbench.scenarios import SCENARIOS
from pcbench.simulation.schedule import common_times, random_times, sampling
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.sampling import Clock, Stamp
from pcbench.study import fits

# one run: its samples, and its schedule


@pytest.mark.ci
@settings(max_examples=60)
@given(clocks=any_clocks(), ticks=ticks_of, root=st.integers(0, 5), seed=seed_of)
def test_a_runs_samples_are_those_its_draws_say(clocks, ticks, root, seed):
    assert draw_samples(clocks, ticks, seed, root) == every_sample(clocks, ticks, root, seed)


@settings(max_examples=25)
@given(data=st.data(), clocks=any_clocks(), ticks=ticks_of, seed=seed_of)
def test_each_sample_is_delivered_once_at_its_tick_or_never_and_says_what_it_is(data, clocks, ticks, seed):
    q, error = width(clocks), delay_errors(data, clocks)
    found = every_sample(clocks, ticks, 0, seed)
    plan = common_times.schedule(draw_samples(clocks, ticks, seed), ticks, q, error)
    instants = sorted({s.tick for s in found})
    coming = {(s.arrives, s.tick) for s in found if s.arrives <= ticks}
    slots = plan.arrive.shape[1]
    assert slots == max([1, *Counter(tick for tick, _ in coming).values()])
    last, seen = 0, []
    for k in range(ticks + 1):
        here = {s.channel: s.number for s in found if s.tick == k}
        assert plan.sense[k] == (instants.index(k) if here else -1)
        assert {j: plan.sample[k, j] for j in np.flatnonzero(plan.sample[k] >= 0)} == here
        noted = [int(packet) for packet in (plan.snapshot[k], *plan.extra_snapshots[k]) if packet >= 0]
        assert noted == sorted({instants.index(s.tick) for s in found if s.tick - error + s.timestamp_error == k})
        oldest_first = sorted(taken for tick, taken in coming if tick == k)
        for slot in range(slots):
            if slot >= len(oldest_first):
                assert plan.arrive[k, slot] == -1
                assert not plan.mask[k, slot].any()
                continue
            taken = oldest_first[slot]
            assert plan.arrive[k, slot] == instants.index(taken)
            (late,) = {s.timestamp_error for s in found if s.tick == taken}
            assert plan.timestamp[k, slot] == max(taken - error + late, 0)
            assert plan.ticks_since_arrival[k, slot] == k - last
            seen += [(k, taken, int(j), int(plan.number[k, slot, j])) for j in np.flatnonzero(plan.mask[k, slot])]
        last = k if oldest_first else last
        assert plan.event[k] == bool(here or oldest_first or plan.snapshot[k] >= 0)
        later = [t for t in range(k + 1, ticks + 1) if plan.event[t]]
        assert plan.next_event[k] == (later[0] if later else ticks + 1)
    assert sorted(seen) == sorted((s.arrives, s.tick, s.channel, s.number) for s in found if s.arrives <= ticks)


# what is claimed of every draw


def packets(clocks, ticks, seed):
    """(taken, clock, number, arrives) of every packet of a run, as `random_times` counts them: one for each clock."""
    each = [
        (c, i, *times) for c, clock in enumerate(clocks) for i, times in enumerate(one_clock(clock, ticks, 0, seed))
    ]
    return sorted((taken, c, i, arrives) for c, i, taken, arrives in each)


@settings(max_examples=60)
@given(clocks=any_clocks(), ticks=ticks_of, seed=seed_of)
@example(clocks=[Clock((0,), 20, None, (20, 20, 3), 1)], ticks=39, seed=2)  # the third is taken at 39, not at 40
def test_intervals_and_ages_are_whole_ticks_in_the_ranges_that_are_claimed(clocks, ticks, seed):
    for clock in clocks:
        claimed = sampling.intervals(clock, ticks)
        assert claimed == sorted(set(claimed))
        assert claimed[0] >= 1
        least, most = sampling.ages(clock, ticks)
        found = one_clock(clock, ticks, 0, seed)
        beyond = one_clock(clock, ticks + 100, 0, seed)
        assert {b - a for (a, _), (b, _) in pairwise(beyond) if a <= ticks} <= set(claimed)
        assert all(least <= arrives - taken <= most for taken, arrives in found if arrives <= ticks)


@pytest.mark.parametrize(
    "clock",
    [
        Clock((0,), 4, None, "uniform", 0, 3),
        Clock((0,), 6, None, "uniform", 1, 0),
        Clock((0,), 6, None, "periodic", 2, 2),
        Clock((0,), 6, 5, "sine", 1, 4),
        Clock((0,), 6, None, (4, 7), 1, 1),
        Clock((0,), 6, None, "sine"),
    ],
    ids=str,
)
def test_every_claimed_interval_and_both_ends_of_the_ages_occur(clock):
    """The rarest has a probability of about 1/75 a sample; 40 runs of fixed seeds have some 600 samples or more."""
    ticks = LONGEST if clock.random else 3 * LONGEST
    runs = [one_clock(clock, ticks, 0, seed) for seed in range(40)]
    gaps = {b - a for run in runs for (a, _), (b, _) in pairwise(run)}
    assert gaps == set(sampling.intervals(clock, ticks))
    ages = {arrives - taken for run in runs for taken, arrives in run if arrives < NEVER}
    assert (min(ages), max(ages)) == sampling.ages(clock, ticks)


@settings(max_examples=60)
@given(clocks=any_clocks(), ticks=ticks_of, seed=seed_of)
def test_the_lag_is_counted_and_never_more_than_is_claimed_beforehand(clocks, ticks, seed):
    found = every_sample(clocks, ticks, 0, seed)
    arriving = {(s.tick + s.timestamp_error, s.arrives) for s in found if s.arrives < NEVER}
    assert common_times.max_oosm_lag(found) == most_ahead(arriving)
    late = ahead(clocks, 0, seed)
    each = [(taken + late[taken], arrives) for taken, _, _, arrives in packets(clocks, ticks, seed) if arrives <= ticks]
    assert most_ahead(each) <= random_times.max_oosm_lag(clocks, ticks)


def most_ahead(times):
    return max((sum(b > taken and late < arrives for b, late in times) for taken, arrives in times), default=0)


def overwritten(rows, size, ticks, error, late=(0,) * (ROOM + 1)):
    """Whether a packet is overwritten in a ring of this size before it arrives: (taken, arrives) by row.

    A value is written when it is taken, a note `error` ticks earlier and as much later as its stamp is; what is believed to be
    from before tick 0 has the note of the start, which is there from the beginning (None).
    """
    values, notes = {}, {}
    for k in range(ticks + 1):
        for row, (taken, _) in enumerate(rows):
            if taken == k:
                values[row % size] = row
            if taken - error + late[min(taken, ROOM)] == k:
                notes[row % size] = row
        for row, (taken, arrives) in enumerate(rows):
            if arrives == k and (values[row % size], notes.get(row % size)) != (
                row,
                row if taken >= error - late[taken] else None,
            ):
                return True
    return False


@settings(max_examples=60)
@given(data=st.data(), clocks=any_clocks(), ticks=ticks_of, seed=seed_of)
def test_no_packet_is_overwritten_in_the_room_that_is_claimed_beforehand(data, clocks, ticks, seed):
    """Notes may be due for samples beyond the horizon: random intervals go on there, the others end."""
    never_overwritten(clocks, ticks, seed, delay_errors(data, clocks))


def test_a_stamp_that_drifts_beyond_the_horizon_asks_for_more_room():
    clock = Clock((0,), 1, None, "uniform", loss=0.1, delay_values=(4, 25, 1), delay_weights=(0.2, 0.3, 0.5), burst=9.5)
    never_overwritten([clock._replace(stamp=Stamp(-3, -0.06, 0))], 28, 1, 25)


def never_overwritten(clocks, ticks, seed, error):
    late = ahead(clocks, 0, seed)
    noted = packets(clocks, ticks + max(error, 0) - min(late[: ticks + 1]), seed)
    rows = [(a, b) for a, c, _, b in noted if a <= ticks or clocks[c].profile == "uniform"]
    assert not overwritten(rows, random_times.room(clocks, ticks, error), ticks, error, late)


@pytest.mark.parametrize(
    ("clocks", "most"),
    [
        ([Clock((0,), 4, 2, "periodic", 0, 12)], 2),
        ([Clock((0,), 4, 2, "periodic", 0, 13)], 3),
        ([Clock((0,), 21, 10), Clock((1,), 4, 0)], 3),
    ],
    ids=["the fourth together", "four ahead", "two clocks"],
)
def test_the_lag_that_is_claimed_beforehand_occurs(clocks, most):
    runs = [[(a, b) for a, _, _, b in packets(clocks, LONGEST, seed)] for seed in range(40)]
    assert max(map(most_ahead, runs)) == random_times.max_oosm_lag(clocks, LONGEST) == most


def test_a_sample_is_overtaken_by_no_more_than_all_others_of_its_run():
    """As late as may be, in a run of 17 samples: room for more would only be compiled."""
    clock = Clock((0,), 6, 6, delay_jitter=900)
    assert random_times.max_oosm_lag([clock], 100) == 16
    assert random_times.max_oosm_lag([clock, clock._replace(channels=(1,))], 100) == 33
    assert random_times.max_oosm_lag([clock], 5000) == 149


@pytest.mark.parametrize("error", [0, 9])
def test_the_room_that_is_claimed_beforehand_is_needed(error):
    clock = Clock((0,), 4, 2, "periodic", 0, 13)
    room = random_times.room([clock], LONGEST, error)
    runs = [[(a, b) for a, _, _, b in packets([clock], LONGEST, seed)] for seed in range(40)]
    assert any(overwritten(rows, room - 1, LONGEST, error) for rows in runs)
    assert not any(overwritten(rows, room, LONGEST, error) for rows in runs)


@settings(max_examples=60)
@given(data=st.data(), clocks=any_clocks(), ticks=ticks_of, seed=seed_of)
def test_a_schedule_says_the_least_room_in_which_no_packet_is_overwritten(data, clocks, ticks, seed):
    error, q = delay_errors(data, clocks), width(clocks)
    plan = common_times.schedule(every_sample(clocks, ticks, 0, seed), ticks, q, error)
    size = common_times.in_flight(plan)
    assert not loses_a_packet(plan, size)
    assert size == 1 or loses_a_packet(plan, size - 1)


@pytest.mark.parametrize(
    ("older", "newer", "room"),
    [
        ((2, common_times.NEVER), (1, 6), 1),  # noted at one tick, the older first
        ((4, common_times.NEVER), (1, 6), 2),  # the older is noted when the newer is still to arrive
        ((4, common_times.NEVER), (1, 3), 1),  # and when it has arrived
    ],
)
def test_an_older_packet_whose_stamp_is_later_needs_room_while_the_newer_one_travels(older, newer, room):
    samples = [common_times.Sample(0, i, i, arrives, ahead) for i, (ahead, arrives) in enumerate((older, newer))]
    plan = common_times.schedule(samples, 8, 1)
    assert common_times.in_flight(plan) == room
    assert [loses_a_packet(plan, size) for size in (1, 2)] == [room == 2, False]


def loses_a_packet(plan, size):
    values, notes = {}, {}
    for k in range(len(plan.sense)):
        for ring, number in (
            (values, plan.sense[k]),
            *((notes, packet) for packet in (plan.snapshot[k], *plan.extra_snapshots[k])),
        ):
            if number >= 0:
                ring[number % size] = number
        for number in plan.arrive[k][plan.arrive[k] >= 0]:
            if values[number % size] != number or notes.get(number % size, number) != number:
                return True
    return False


# many runs at once


def agenda_of(clocks, seeds, ticks=LONGEST):
    """The agenda of some runs, as NumPy arrays; C clocks and L seeds fix the shape."""
    t = roomy(clocks, ticks, width(clocks), 0)._replace(clock_of=np.zeros(1, int))
    plan = AGENDA(jax.tree.map(jnp.asarray, t), jnp.asarray(0), jnp.asarray(seeds))
    return jax.tree.map(np.asarray, plan)


@pytest.mark.ci
@settings(max_examples=20)
@given(clocks=any_clocks(), ticks=ticks_of, first=st.integers(0, 2**20))
def test_the_agenda_of_every_run_is_what_its_samples_say(clocks, ticks, first):
    seeds = np.arange(first, first + SEEDS)
    plan = agenda_of(clocks, seeds, ticks)
    for lane, seed in enumerate(seeds):
        rows = packets(clocks, ticks, seed)
        first = {row[0]: i for i, row in reversed(list(enumerate(rows)))}  # the row of each packet
        many, late = len(rows), ahead(clocks, 0, seed)
        taken, timestamp, number = plan.sampling_ticks[:, lane], plan.timestamp[:, lane], plan.number[..., lane]
        assert taken[:many].tolist() == [row[0] if first[row[0]] == i else NEVER for i, row in enumerate(rows)]
        assert timestamp[:many].tolist() == [NEVER if t == NEVER else t + late[t] for t in taken[:many].tolist()]
        assert (taken[many:] > ticks).all()
        want = np.full((len(clocks), many), -1)
        for at, clock, index, _ in rows:
            want[clock, first[at]] = index
        assert number[:, :many].tolist() == want.tolist()
        arrivals = {}
        for at, clock, _, arrives in rows:
            if arrives <= ticks:
                arrivals.setdefault((arrives, at), set()).add(clock)
        last, slot, previous = (0, 0), 0, None
        due = [i for i in range(len(taken)) if plan.arrives[i, lane] <= ticks]
        for i, ((arrives, at), clocks_of) in zip(due, sorted(arrivals.items()), strict=True):
            last, slot = (last, slot + 1) if arrives == previous else ((last[1], arrives), 0)
            previous = arrives
            assert plan.arrives[i, lane] == arrives
            assert (plan.packet[i, lane], plan.slot[i, lane], plan.ticks_since_arrival[i, lane]) == (
                first[at],
                slot,
                arrives - last[0],
            )
            assert set(np.flatnonzero(plan.mask[:, i, lane])) == clocks_of


PAIR = [Clock((0, 2), 9, None, "uniform", 1, 12, 0.3), Clock((1,), 7, 5, "sine", 1, 20, 0.5)]


@pytest.mark.ci
def test_a_runs_agenda_does_not_depend_on_the_other_runs():
    together = agenda_of(PAIR, np.arange(SEEDS))
    alone, backwards = agenda_of(PAIR, np.full(SEEDS, 3)), agenda_of(PAIR, np.arange(SEEDS)[::-1])
    for a, b, c in zip(together, alone, backwards, strict=True):
        np.testing.assert_array_equal(np.broadcast_to(a[..., 3:4], a.shape), b)
        np.testing.assert_array_equal(a, c[..., ::-1])
    assert len({together.number[..., lane].tobytes() for lane in range(SEEDS)}) == SEEDS


def times_of(clocks, seeds=range(SEEDS), root=0):
    """(taken, arrives) [ROOM, L] of each clock."""
    t = jax.tree.map(jnp.asarray, roomy(clocks, LONGEST, width(clocks), 0))
    address = jnp.asarray(root), jnp.asarray(seeds)
    return [jax.tree.map(np.asarray, CLOCK_TIMES(t, jnp.asarray(c), *address)) for c in range(len(clocks))]


def change_clocks(**change):
    return [clock._replace(**change) for clock in PAIR]


def test_a_run_alone_has_the_draws_it_has_among_others():
    for (a, b), (taken, arrives) in zip(times_of(PAIR), times_of(PAIR, [3]), strict=True):
        np.testing.assert_array_equal(a[:, 3:4], taken)
        np.testing.assert_array_equal(b[:, 3:4], arrives)


def test_losses_do_not_move_the_times():
    base = times_of(PAIR)
    for loss in (0.0, 0.1, 0.9):
        for (taken, arrives), (same, later) in zip(base, times_of(change_clocks(loss=loss)), strict=True):
            np.testing.assert_array_equal(taken, same)
            both = (arrives < NEVER) & (later < NEVER)
            assert both.any()
            np.testing.assert_array_equal(arrives[both], later[both])
            lost = set(map(tuple, np.argwhere(arrives == NEVER))), set(map(tuple, np.argwhere(later == NEVER)))
            assert lost[0] < lost[1] if loss == 0.9 else lost[0] > lost[1], "who is lost stays lost where more are"


@pytest.mark.parametrize(
    "change", [{"jitter": 0}, {"delay_jitter": 0}, {"profile": "periodic"}, {"period": 20}, {"delay": 3}]
)
def test_times_do_not_move_the_losses(change):
    known = slice(0, 4)  # taken within every horizon
    for (_, arrives), (_, later) in zip(times_of(PAIR), times_of(change_clocks(**change)), strict=True):
        np.testing.assert_array_equal(arrives[known] == NEVER, later[known] == NEVER)
        assert (arrives[known] == NEVER).any()


def test_jitters_leave_alone_what_they_are_not_of():
    base = times_of(PAIR)
    for change in ({"delay_jitter": 0}, {"delay": 40}):
        for (taken, _), (same, _) in zip(base, times_of(change_clocks(**change)), strict=True):
            np.testing.assert_array_equal(taken, same)
    for (taken, _), (due, _) in zip(base, times_of(change_clocks(jitter=0)), strict=True):
        assert set((taken - due)[1:][due[1:] <= LONGEST]) == {-1, 0, 1}
        assert not taken[0].any(), "the first sample is taken at tick 0"


def test_clocks_runs_and_studies_have_draws_of_their_own_under_the_first_channel():
    twins = [Clock((j,), 9, None, "uniform", 1, 12, 0.3) for j in range(2)]
    a, b = times_of(twins)
    taken = [a[0], b[0], times_of(twins, root=1)[0][0], times_of(twins, root=1)[1][0]]
    assert len({column.tobytes() for each in taken for column in each.T}) == 4 * SEEDS
    for got, want in zip(times_of(twins[::-1]), (b, a), strict=True):
        np.testing.assert_array_equal(got, want)
    np.testing.assert_array_equal(times_of([twins[0], twins[1]._replace(loss=1.0, profile="sine")])[0], a)


@pytest.mark.parametrize("loss", [0.0, 0.25, 1.0])
def test_as_many_are_lost_as_the_probability_says(loss):
    """Within four standard errors."""
    lost = times_of([Clock((0, 1), 1, 3, loss=loss)])[0][1][:LONGEST] == NEVER
    assert abs(lost.mean() - loss) <= 4 * np.sqrt(loss * (1 - loss) / lost.size)


@pytest.mark.ci
@pytest.mark.parametrize("clocks", [PAIR, [Clock((0, 1), 5, 0, (3, 11, 4), 1)]], ids=["two", "one"])
def test_the_room_for_samples_changes_nothing(clocks):
    for seed in range(4):
        assert draw_samples(clocks, 63, seed, times=TIMES) == draw_samples(clocks, 63, seed)


@pytest.mark.ci
def test_every_sample_within_the_horizon_is_taken_also_where_random_intervals_are_jittered():
    clock = Clock((0,), 5, 0, "uniform", 1)
    for seed in range(60):
        assert draw_samples([clock], 5, seed, times=TIMES) == draw_samples([clock], 5, seed)


def test_jitter_is_bounded_by_a_short_interval_that_it_brings_into_the_horizon():
    """Due at 5, 10.001 and 10.011 s: with a jitter of 1 s the last two may be swapped before the end at 10 s."""
    scenario = SCENARIOS["cart/variable"].with_fields(sampling_pattern=(5.0, 5.001, 0.01), sampling_jitter=1.0)
    with pytest.raises(UserError, match=r"intervals down to 0\.01 s"):
        fits.fits(scenario, "here")
    fits.fits(scenario.with_fields(sampling_jitter=0.004), "here")
