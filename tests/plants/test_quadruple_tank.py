"""The quadruple tank: its equilibrium, its time constants, its linear model, and a run against the reference."""

import jax.numpy as jnp
import numpy as np
import pytest
from reference import ekf, threefry

import pcbench
from pcbench.plants import quadruple_tank

AREA, OUTLET, G = np.array([28.0, 32, 28, 32]), np.array([0.071, 0.057, 0.071, 0.057]), 981.0
K1, K2, SHARE1, SHARE2, KC = 3.33, 3.35, 0.7, 0.6, 0.5
SIGNALS = [name for name, _ in quadruple_tank.SIGNALS]


def motion(h, v):
    """The four balances, with whole levels and voltages."""
    q = OUTLET * np.sqrt(2 * G * h)
    filled = [q[2] + SHARE1 * K1 * v[0], q[3] + SHARE2 * K2 * v[1], (1 - SHARE2) * K2 * v[1], (1 - SHARE1) * K1 * v[0]]
    return (np.array(filled) - q) / AREA


def test_operating_point_is_the_equilibrium_and_printed_levels_are_none():
    np.testing.assert_allclose(quadruple_tank.LEVEL, [12.263, 12.783, 1.634, 1.409], atol=5e-4)
    np.testing.assert_allclose(motion(quadruple_tank.LEVEL, [3.0, 3.0]), 0, atol=1e-14)
    assert np.abs(motion(np.array([12.4, 12.7, 1.8, 1.4]), [3.0, 3.0])).max() > 1e-3
    numbers = quadruple_tank.Numbers()
    assert not quadruple_tank.residual(numbers).any()
    moves = quadruple_tank.residual(numbers._replace(k1=3.5))
    assert moves[0] == pytest.approx(SHARE1 * (3.5 - K1) * 3 / 28, rel=1e-12)


def test_linear_model_is_the_slope_of_the_balances_and_has_the_printed_time_constants():
    model, h = quadruple_tank.nominal(quadruple_tank.Numbers()), quadruple_tank.LEVEL
    for j in range(4):
        moved = h.astype(complex)
        moved[j] += 1e-30j
        q = OUTLET * np.sqrt(2 * G * moved)
        slope = (np.array([q[2] - q[0], q[3] - q[1], -q[2], -q[3]]) / AREA).imag / 1e-30
        np.testing.assert_allclose(model.A[:, j], slope, rtol=0, atol=1e-14)
    np.testing.assert_allclose(model.B.sum(1), motion(h, [4.0, 4.0]), rtol=0, atol=1e-14)
    printed = np.array([12.4, 12.7, 1.8, 1.4])
    T = -1 / np.diag(model.A) * np.sqrt(printed / h)
    np.testing.assert_allclose(T, [62.70, 90.34, 23.89, 29.99], atol=5e-3)


@pytest.mark.ci
def test_run_is_the_references():
    """Level and voltage by whole values, one Runge-Kutta step a tick, with the draws of the run."""
    seed, ticks = 4, 300
    study = {"base": "quadruple-tank/delayed", "duration": float(ticks), "steady_start": 100.0}
    frame = pcbench.simulate({"name": "tanks", "scenario": study}, ["ekf"], seed=seed)
    h, want = quadruple_tank.LEVEL + np.array([1.0, -1.0, 0.3, -0.3]), []
    for k in range(ticks + 1):
        want.append(h - quadruple_tank.LEVEL)
        u = np.array([0.3 if k % 400 < 200 else -0.3, 0.3 if k % 600 < 300 else -0.3])
        w = 0.02 * np.array([threefry.normal(0, seed, "process", c, k) for c in range(4)])
        h = ekf.rk4(motion, h, 3.0 + u, 1.0) + w
    np.testing.assert_allclose(frame[SIGNALS].to_numpy(), want, rtol=0, atol=1e-10)
    y = KC * np.array(want)[:, 1]
    arrived = frame["y2"].to_numpy()
    v = [threefry.normal(0, seed, "measurement", 1, i) for i in range(3)]
    for i in range(3):
        assert arrived[60 + 5 * i] == pytest.approx(y[5 * i] + 0.02 * v[i], abs=1e-10)


def test_empty_tank_lets_nothing_out():
    numbers = quadruple_tank.prepare(quadruple_tank.Numbers(), 1.0, 0)
    levels = np.array([0.0, 0.005, quadruple_tank.EMPTY, 12.0])
    want = [0.0, 0.5 * np.sqrt(2 * G * 0.01), np.sqrt(2 * G * 0.01), np.sqrt(2 * G * 12.0)]
    np.testing.assert_allclose(quadruple_tank.speed(*map(jnp.asarray, (numbers.g, levels))), want, rtol=1e-6)
