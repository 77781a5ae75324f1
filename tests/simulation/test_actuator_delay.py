"""The actuator line against a plain list of commands: what is held over a tick, for any delay, and what a ring forgets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcbench.simulation import command_network

DT, N = 1e-3, 400


def command(n):
    """Two commands at tick n, below 0 too: no two alike."""
    return np.stack([np.sin(0.7 * n) + 0.01 * n, np.cos(1.3 * n)], -1)


def ring(rows, newest):
    """The newest `rows` commands, as a loop keeps them."""
    out = np.zeros((rows, 2))
    for n in range(newest - rows + 1, newest + 1):
        out[n % rows] = command(n)
    return jnp.asarray(out)


def interpolate(delay, n, newest):
    """Linear interpolation at the middle of the tick less the delay, by np.interp over all ticks."""
    ticks = np.arange(-4000, newest + 1)
    when = (n + 0.5) - delay((n + 0.5) * DT) / DT
    return np.array([np.interp(when, ticks, column) for column in command(ticks).T])


read = jax.jit(command_network.delayed_command)


@given(
    st.floats(0.0005, 0.08), st.floats(0.0, 0.4), st.floats(0.1, 3.0), st.integers(0, N), st.integers(0, 100),
)  # fmt: skip
@settings(max_examples=60)
@pytest.mark.nightly
def test_the_input_is_the_command_of_the_middle_of_the_tick(mean, part, pace, k, age):
    def delay(t):
        return mean * (1 - part * np.sin(pace * t) ** 2) + 0.0005 * part  # never below half a tick

    rows = command_network.rows_needed(delay, DT, N, 100)
    line = command_network.delay_line(delay, DT, rows, N)
    found = read(line, ring(rows, k), jnp.asarray(k - age), jnp.asarray(k))
    np.testing.assert_allclose(found, interpolate(delay, k - age, k), rtol=0, atol=1e-10)


def test_without_delay_it_is_the_command_of_the_tick():
    line = command_network.delay_line(np.zeros_like, DT, 8, N)
    for k in (0, 1, 7, 300):
        np.testing.assert_array_equal(read(line, ring(8, k), jnp.asarray(k), jnp.asarray(k)), command(k))


def test_what_is_not_yet_decided_is_taken_for_the_newest():
    """Looking ahead: commands up to tick 99, ticks whose input needs later ones."""
    line = command_network.delay_line(lambda t: np.full(np.shape(t), 0.025), DT, 64, N + 64)
    for ahead in (0, 10, 24, 25, 40):
        n = 100 + ahead
        known = [command(min(n - 25 + i, 99)) for i in (0, 1)]
        found = read(line, ring(64, 99), jnp.asarray(n), jnp.asarray(99))
        np.testing.assert_allclose(found, (known[0] + known[1]) / 2, rtol=0, atol=1e-12)


@pytest.mark.parametrize("k", [0, 5, 200])
def test_a_ring_never_gives_another_ticks_command(k):
    """One tick older than what it keeps is NaN, and what it was made for is kept."""

    def delay(t):
        return np.full(np.shape(t), 0.025)

    rows, oldest = command_network.rows_needed(delay, DT, N, 30), 30
    line = command_network.delay_line(delay, DT, rows, N)
    ages = np.arange(rows + 5)
    found = np.array([read(line, ring(rows, k), jnp.asarray(k - age), jnp.asarray(k)) for age in ages])
    kept = np.isfinite(found).all(1)
    assert kept[: oldest + 1].all()
    assert not kept[rows:].any()
    assert (np.diff(kept.astype(int)) <= 0).all()
    for age in ages[kept]:
        np.testing.assert_allclose(found[age], interpolate(delay, k - age, k), rtol=0, atol=1e-10)


def test_commands_are_written_where_they_are_read():
    commands = ring(16, 40)
    for k in range(41, 60):
        commands = command_network.write(commands, jnp.asarray(k), jnp.asarray(command(k)))
        np.testing.assert_array_equal(commands, ring(16, k))
