"""Inputs as their formulas say, by hand: values, order, and where they jump."""

import numpy as np
import pytest

from pcbench.scenarios import signals

T = np.array([0.0, 0.3, 1.0, 1.2, 2.5, 4.1])


def test_one_signal_is_for_all_inputs_and_several_each_for_its_own():
    both = signals.inputs("sine, square", T, 2)
    np.testing.assert_allclose(both[:, 0], np.sin(4 * T), atol=1e-15)
    np.testing.assert_array_equal(both[:, 1], [1, 1, -1, -1, 1, 1])
    np.testing.assert_array_equal(signals.inputs("square", T, 3), np.tile(both[:, 1:], 3))
    np.testing.assert_array_equal(signals.inputs("heater-1s", T, 2)[0], [0.02, 500.0])


@pytest.mark.parametrize(
    ("name", "want"),
    [
        ("sawtooth", [10.0, 10 - 20 * 0.3 / np.pi, 10 - 20 / np.pi, 10 - 24 / np.pi, 10 - 50 / np.pi, 30 - 82 / np.pi]),
        ("step", [1.0] * 6),
        ("zero", [0.0] * 6),
        ("arm-sawtooth", [0.0, -0.15, -0.15, -0.05, -0.25, -0.05]),
    ],
)
def test_a_signal_is_its_formula(name, want):
    np.testing.assert_allclose(signals.SIGNALS[name](T)[:, 0], want, atol=1e-14)
    if name == "sawtooth":
        np.testing.assert_array_equal(signals.SIGNALS["rising"](T), -signals.SIGNALS["sawtooth"](T))


def test_the_tanks_inputs_are_held_for_so_many_samples():
    u = signals.SIGNALS["heater-10s"](10.0 * np.arange(130))
    np.testing.assert_array_equal(u[:, 0], [0.02 if k % 40 < 20 else -0.02 for k in range(130)])
    np.testing.assert_array_equal(u[:, 1], [500.0 if k % 60 < 30 else -300.0 for k in range(130)])


def test_a_path_comes_with_its_derivatives():
    t, h = np.array([0.7, 2.0]), 1e-5
    at, before, after = (signals.PATHS["circle"](t + by) for by in (0.0, -h, h))
    np.testing.assert_allclose(at[:, 0], np.stack([1 + 0.5 * np.sin(t), 1 - 0.5 * np.cos(t)], -1), rtol=1e-15)
    np.testing.assert_allclose(at[:, 1], (after - before)[:, 0] / (2 * h), atol=1e-9)
    np.testing.assert_allclose(at[:, 2], (after - before)[:, 1] / (2 * h), atol=1e-9)
    np.testing.assert_array_equal(signals.PATHS["still"](t), np.tile([[[1.0, 1], [0, 0], [0, 0]]], (2, 1, 1)))


@pytest.mark.parametrize(
    ("names", "dt", "ticks", "want"),
    [
        ("square", 0.25, 12, [4, 8, 12]),
        ("arm-sawtooth", 0.3, 20, [7, 14, 20]),
        ("square, arm-sawtooth", 0.5, 9, [2, 4, 6, 8]),
        ("sawtooth", 1e-3, 7000, [3142, 6284]),
        ("sine", 0.1, 100, []),
    ],
)
def test_a_jump_is_seen_at_the_first_tick_after_it(names, dt, ticks, want):
    assert signals.jumps(names, dt, ticks).tolist() == want
