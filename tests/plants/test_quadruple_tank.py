"""The quadruple tank: its equilibrium, its time constants, its linear model, and a run against the reference."""

import jax.numpy as jnp
import numpy as np
import pytest
from reference import ekf, threefry

import pcbench
from pcbench.plants import numbers_of, quadruple_tank
from pcbench.scenarios import SCENARIOS

AREA, OUTLET, G = np.array([28.0, 32, 28, 32]), np.array([0.071, 0.057, 0.071, 0.057]), 981.0
K1, SHARE1, KC = 3.33, 0.7, 0.5
PUMPS = {"P-": (3.33, 3.35, 0.7, 0.6), "P+": (3.14, 3.29, 0.43, 0.34)}  # k1, k2, gamma1, gamma2
VOLTS = {"P-": 3.0, "P+": 3.15}
EQUILIBRIA = {"P-": [12.263, 12.783, 1.634, 1.409], "P+": [12.442, 13.167, 4.730, 4.986]}
PRINTED = {"P-": [12.4, 12.7, 1.8, 1.4], "P+": [12.6, 13.0, 4.8, 4.9]}
SCENARIO = {"P-": "quadruple-tank/delayed", "P+": "quadruple-tank/right-zero"}
LEVEL = quadruple_tank.POINTS["P-"].level
SIGNALS = [name for name, _ in quadruple_tank.SIGNALS]


def motion(h, v, point="P-"):
    """The four balances, with whole levels and voltages."""
    k1, k2, share1, share2 = PUMPS[point]
    q = OUTLET * np.sqrt(2 * G * h)
    filled = [q[2] + share1 * k1 * v[0], q[3] + share2 * k2 * v[1], (1 - share2) * k2 * v[1], (1 - share1) * k1 * v[0]]
    return (np.array(filled) - q) / AREA


@pytest.mark.parametrize("point", PUMPS)
def test_operating_point_is_the_equilibrium_and_printed_levels_are_none(point):
    level, volts = quadruple_tank.POINTS[point].level, np.full(2, VOLTS[point])
    np.testing.assert_allclose(level, EQUILIBRIA[point], atol=5e-4)
    np.testing.assert_allclose(motion(level, volts, point), 0, atol=1e-14)
    assert np.abs(motion(np.array(PRINTED[point]), volts, point)).max() > 1e-3
    assert not quadruple_tank.residual(numbers_of(SCENARIOS[SCENARIO[point]])).any()


def test_other_constants_are_no_equilibrium():
    numbers = quadruple_tank.Numbers()
    moves = quadruple_tank.residual(numbers._replace(k1=3.5))
    assert moves[0] == pytest.approx(SHARE1 * (3.5 - K1) * 3 / 28, rel=1e-12)


def test_linear_model_is_the_slope_of_the_balances():
    model, h = quadruple_tank.nominal(quadruple_tank.Numbers()), LEVEL
    for j in range(4):
        moved = h.astype(complex)
        moved[j] += 1e-30j
        q = OUTLET * np.sqrt(2 * G * moved)
        slope = (np.array([q[2] - q[0], q[3] - q[1], -q[2], -q[3]]) / AREA).imag / 1e-30
        np.testing.assert_allclose(model.A[:, j], slope, rtol=0, atol=1e-14)
    np.testing.assert_allclose(model.B.sum(1), motion(h, [4.0, 4.0]), rtol=0, atol=1e-14)


@pytest.mark.parametrize(("point", "T"), [("P-", [62.70, 90.34, 23.89, 29.99]), ("P+", [63.21, 91.40, 39.01, 56.11])])
def test_printed_levels_give_the_printed_time_constants(point, T):
    """T is proportional to the root of the level."""
    model = quadruple_tank.nominal(numbers_of(SCENARIOS[SCENARIO[point]]))
    found = -1 / np.diag(model.A) * np.sqrt(PRINTED[point] / quadruple_tank.POINTS[point].level)
    np.testing.assert_allclose(found, T, atol=5e-3)


@pytest.mark.ci
@pytest.mark.parametrize("point", PUMPS)
def test_run_is_the_references(point):
    """Level and voltage by whole values, one Runge-Kutta step a tick, with the draws of the run."""
    seed, ticks = 4, 300
    study = {"base": SCENARIO[point], "duration": float(ticks), "steady_start": 100.0}
    frame = pcbench.simulate({"name": "tanks", "scenario": study}, ["ekf"], seed=seed)
    level = quadruple_tank.POINTS[point].level
    h, want = level + np.array([1.0, -1.0, 0.3, -0.3]), []
    for k in range(ticks + 1):
        want.append(h - level)
        u = np.array([0.3 if k % 400 < 200 else -0.3, 0.3 if k % 600 < 300 else -0.3])
        w = 0.02 * np.array([threefry.normal(0, seed, "process", c, k) for c in range(4)])
        h = ekf.rk4(lambda h, v: motion(h, v, point), h, VOLTS[point] + u, 1.0) + w
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
