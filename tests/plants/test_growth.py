"""The growth model: a run, its extended and its unscented filter by hand, and the errors of the particle filter's paper."""

import numpy as np
import pytest
from reference import threefry

import pcbench

SEED = 7
Q, R = 10.0, 1.0
VARIANTS = {"gordon": (0.1, 2.0, 0, 50), "arulampalam": (0.0, 10.0, 1, 100)}  # x(0), P(0), phase, steps


def move(x, k):
    return x / 2 + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * k)


def run(x0, phase, steps):
    """The states of all steps and the measurements from step 1 on, with the draws of the run."""
    x = [x0]
    for k in range(steps):
        x.append(move(x[-1], k + phase) + np.sqrt(Q) * threefry.normal(0, SEED, "process", 0, k))
    v = [threefry.normal(0, SEED, "measurement", 0, i) for i in range(steps)]
    return np.array(x), np.array(x[1:]) ** 2 / 20 + v


def extended_filter(y, P, phase):
    m, out = 0.0, [0.0]
    for k in range(len(y)):
        slope = 0.5 + 25 * (1 - m**2) / (1 + m**2) ** 2
        m, P = move(m, k + phase), slope**2 * P + Q
        H = m / 10
        S = H * P * H + R
        m, P = m + P * H / S * (y[k] - m**2 / 20), P - (P * H) ** 2 / S
        out.append(m)
    return np.array(out)


def unscented(y, P, phase):
    """Points m and m +- sqrt(3 P), weights 2/3 and 1/6."""
    w, m, out = np.array([2 / 3, 1 / 6, 1 / 6]), 0.0, [0.0]

    def points(m, P):
        return m + np.sqrt(3 * P) * np.array([0.0, 1.0, -1.0])

    for k in range(len(y)):
        z = move(points(m, P), k + phase)
        m = w @ z
        P = w @ (z - m) ** 2 + Q
        z = points(m, P)
        h = z**2 / 20
        S, c = w @ (h - w @ h) ** 2 + R, w @ ((z - m) * (h - w @ h))
        m, P = m + c / S * (y[k] - w @ h), P - c**2 / S
        out.append(m)
    return np.array(out)


@pytest.mark.ci
@pytest.mark.parametrize("variant", VARIANTS)
def test_run_and_its_filters_are_the_references(variant):
    x0, P0, phase, steps = VARIANTS[variant]
    frame = pcbench.simulate(f"growth-model/{variant}", ["ekf", "ukf"], seed=SEED)
    assert len(frame) == steps + 2
    x, y = run(x0, phase, steps)
    for name, want in (("x", x), ("ekf.x", extended_filter(y, P0, phase)), ("ukf.x", unscented(y, P0, phase))):
        np.testing.assert_allclose(frame[name].to_numpy()[: steps + 1], want, rtol=0, atol=1e-10 * np.abs(want).max())


def test_another_tick_is_refused():
    with pytest.raises(pcbench.UserError, match=r"got a tick of 0.5 s where step moves by 1 s"):
        pcbench.simulate({"name": "half", "scenario": {"base": "growth-model/gordon", "dt": 0.5}}, ["ekf"])


@pytest.mark.nightly
def test_errors_of_the_study_are_those_of_an_independent_program():
    """Mean root mean square error of a run over 400 runs, with x(0) from N(0, 5): within 3 of both standard errors."""
    stats = pcbench.run("growth-model").stats
    found = stats[stats.metric == "steady_rmse"].set_index("observer")
    for name, mean, error in (("ekf", 20.3, 0.6), ("ukf", 10.9, 0.15), ("particle", 4.51, 0.05)):
        assert found.loc[name, "mean"] == pytest.approx(mean, abs=3 * np.hypot(error, found.loc[name, "se"])), name
