"""What a function may know of the present: the input of now only where it is decided, and inputs of the past by their age."""

import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.simulation import command_network
from pcbench.simulation.types import GridPointParams, present

INPUTS = np.array([[3.0, -1.0], [4.0, -1.5], [5.0, 9.0], [2.0, 6.0], [-7.0, 8.0]])


def at(tick, decided, commands=(), line=command_network.NO_DELAY_LINE):
    numbers = (np.zeros(1),) * 8
    p = GridPointParams((), {}, (), jnp.asarray(INPUTS), jnp.asarray(0.5), *numbers[:7], line=line)
    return present(p, jnp.asarray(tick), decided, commands)


@pytest.mark.parametrize("tick", range(len(INPUTS)))
def test_the_input_of_now_is_known_once_it_is_decided_and_before_that_the_last_one(tick):
    np.testing.assert_array_equal(at(tick, True).u, INPUTS[tick])
    np.testing.assert_array_equal(at(tick, False).u, INPUTS[tick - 1] if tick else 0 * INPUTS[0])


@pytest.mark.parametrize("tick", range(len(INPUTS)))
def test_inputs_of_the_past_are_found_by_age_and_are_zero_before_the_start(tick):
    for age in range(tick + 3):
        want = INPUTS[tick - age] if age <= tick else 0 * INPUTS[0]
        np.testing.assert_array_equal(at(tick, False).past_u(jnp.asarray(age)), want)


def test_time_is_that_of_the_tick_in_seconds():
    now = at(3, True)
    assert (float(now.t), int(now.tick), float(now.dt)) == (1.5, 3, 0.5)


def test_in_a_closed_loop_the_input_of_now_is_the_command_that_has_become_of_age():
    """Commands act two ticks later; the command of now is given to tick 4 once it is decided."""
    line = command_network.delay_line(lambda t: np.full(np.shape(t), 1.0), 0.5, 8, 12)
    commands = jnp.asarray(np.arange(8.0)[:, None] ** 2)  # of ticks 0 .. 7, in rows of their own
    for tick in (5, 6, 7):
        half = [np.mean([(tick - 2) ** 2, (tick - 1) ** 2])]  # the middle of the tick less two ticks
        np.testing.assert_allclose(at(tick, True, commands, line).u, half)
        before = [np.mean([(tick - 3) ** 2, (tick - 2) ** 2])]
        np.testing.assert_allclose(at(tick, False, commands, line).u, before)
    stale = commands.at[6].set(np.nan)  # the row of tick 6 until its command is put there
    np.testing.assert_array_equal(at(6, False, stale, line).past_u(jnp.asarray(0)), [np.mean([16, 25])])
    np.testing.assert_array_equal(
        at(6, False, stale, command_network.delay_line(np.zeros_like, 0.5, 8, 12)).past_u(jnp.asarray(0)), [25]
    )
    straight = command_network.delay_line(np.zeros_like, 0.5, 8, 12)
    assert at(7, True, commands, straight).u == 49.0
