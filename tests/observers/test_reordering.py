"""Samples that overtake each other are put back: by the tick they were taken, and of one tick as they came."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.observers.parts import reorder_buffer
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.planning.operation_counts import count_multiplications

BASE = 7.0  # a state is the numbers of all samples used, in their order, as digits


def digits(state, sample):
    return state * BASE + sample.value[0]


def replay_arrivals(arrivals, room):
    """The state after each arrival, where an arrival is (tick taken, number)."""
    line, out = reorder_buffer.start(jnp.asarray(0.0), np.zeros(room), 1, 0), []
    step = jax.jit(lambda line, sample: reorder_buffer.replay(digits, line, sample))
    for taken, number in arrivals:
        line, state = step(line, sample_of(taken, number))
        assert float(reorder_buffer.newest(digits, line)) == float(state)
        out.append(float(state))
    return out


def sample_of(taken, number):
    return Measurement(jnp.asarray(taken), jnp.array([float(number)]), jnp.array([True]), jnp.zeros(0))


def sorted_all(arrivals):
    """The same by sorting all that has come, oldest first; a sort that keeps what is alike in its order."""
    out = []
    for many in range(1, len(arrivals) + 1):
        value = 0.0
        for _, number in sorted(arrivals[:many], key=lambda each: each[0]):
            value = value * BASE + number
        out.append(value)
    return out


CASES = {
    "in order": ([(0, 1), (5, 2), (9, 3), (12, 4)], 0),
    "one overtaken": ([(0, 1), (9, 2), (5, 3), (12, 4), (11, 5)], 1),
    "three late ones": ([(0, 1), (20, 2), (15, 3), (10, 4), (5, 5), (30, 6)], 3),
    "of one tick": ([(3, 1), (3, 2), (8, 3), (8, 4), (3, 5), (8, 6), (9, 1)], 4),
}


@pytest.mark.ci
@pytest.mark.parametrize("rest", [(), (1,)], ids=["state before", "and after"])
@pytest.mark.parametrize("case", CASES)
def test_the_state_is_that_of_all_samples_in_the_order_they_were_taken(case, rest):
    arrivals, places = CASES[case]
    assert replay_arrivals(arrivals, (places, *rest)) == sorted_all(arrivals)


@pytest.mark.parametrize(("taken", "products"), [(40, 2), (25, 6)])
def test_a_sample_in_order_costs_two_steps_if_the_state_after_the_newest_is_stored(taken, products):
    line = reorder_buffer.start(jnp.asarray(0.0), np.zeros((5, 1)), 1, 0)
    for number in range(1, 6):
        line, _ = reorder_buffer.replay(digits, line, sample_of(10 * number - 20, number))
    replay = partial(reorder_buffer.replay, digits)
    assert count_multiplications(replay, line, sample_of(taken, 6)) == products


@pytest.mark.parametrize("room", [(4,), (4, 1)])
def test_a_copy_is_made_between_the_samples_around_it(room):
    """In order and out of it, with and without the state after the newest sample."""
    line, copy = reorder_buffer.start(jnp.asarray(0.0), np.zeros(room), 1, 0), lambda state, sample: state * BASE + 6.0
    replay = jax.jit(partial(reorder_buffer.replay, digits))
    for arrival in [(3, 1), (5, 2), (9, 3), (12, 4)]:
        line, _ = replay(line, sample_of(*arrival))
    with_copy = jax.jit(partial(reorder_buffer.newest_with_copy, digits, copy))
    for taken, expected in ((13, "12346"), (12, "12346"), (10, "12364"), (1, "61234")):
        assert float(with_copy(line, sample_of(taken, 5))) == int(expected, 7), taken


@pytest.mark.ci
def test_more_room_than_is_needed_changes_nothing():
    arrivals, places = CASES["three late ones"]
    assert replay_arrivals(arrivals, places) == replay_arrivals(arrivals, places + 3)
