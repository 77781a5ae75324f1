"""Intermittent observations: the critical arrival rate, the bounds of the expected covariance, and a run by hand."""

import numpy as np
import pytest
from reference import threefry

import pcbench
from pcbench.scenarios import SCENARIOS

A, Q, R, STEPS = 1.25, 1.0, 2.5, 100
BASE = "intermittent/scalar"


def bounds(p, rounds=100_000):
    """The lower and the upper bound S, V of the expected covariance by their recursions from 0; inf if one grows forever."""
    S = V = 0.0
    for _ in range(rounds):
        S, V = (1 - p) * A**2 * S + Q, A**2 * V + Q - p * A**2 * V**2 / (V + R)
        if V > 1e12:
            return (S if (1 - p) * A**2 < 1 else np.inf), np.inf
    return S, V


def test_bounds_are_finite_exactly_above_the_critical_arrival_rate():
    assert np.isfinite(bounds(0.361)).all()
    assert np.isinf(bounds(0.359)).all()
    assert pytest.approx(0.36) == 1 - 1 / A**2


@pytest.mark.parametrize(
    ("p", "S", "V"), [(0.37, 64.0, 155.0), (0.4, 16.0, 39.51), (0.6, 2.667, 7.327), (1, 1, 3.18996)]
)
def test_bounds_have_their_values(p, S, V):
    assert bounds(p) == pytest.approx((S, V), rel=1e-3)


@pytest.mark.parametrize(("p", "median"), [(0.37, 7.2), (0.4, 6.8), (0.6, 4.0)])
def test_median_covariance_is_far_below_the_upper_bound(p, median):
    """The median of 2000 runs after 100 steps; the law has a heavy tail, so a mean says little at 0.37."""
    draws, P, found = np.random.default_rng(1), np.ones(2000), []
    for k in range(300):
        P = A**2 * P + Q - (draws.random(2000) < p) * A**2 * P**2 / (P + R)
        found += [np.median(P)] if k >= 100 else []
    assert np.mean(found) == pytest.approx(median, abs=0.1)
    assert np.mean(found) < bounds(p)[1] / 1.5


def test_run_of_the_filter_is_the_references():
    seed, m, P, want = 3, 0.0, 1.0, []
    frame = pcbench.simulate(BASE, "kf", seed=seed)
    x, lost = 0.0, 0
    for k in range(STEPS + 1):
        if threefry.uniform(0, seed, "loss", 0, k, 1)[0] < 0.4:
            lost += 1
        else:
            y = x + np.sqrt(R) * threefry.normal(0, seed, "measurement", 0, k)
            m, P = m + P / (P + R) * (y - m), P - P**2 / (P + R)
        want.append((x, m))
        x, m, P = A * x + threefry.normal(0, seed, "process", 0, k), A * m, A**2 * P + Q
    want = np.array(want)
    got = frame[["x", "kf.x"]].to_numpy()
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-10 * np.abs(want).max())
    np.testing.assert_allclose(got[:, 0] - got[:, 1], want[:, 0] - want[:, 1], rtol=0, atol=1e-10 * np.abs(want).max())
    assert 25 < lost < 55


@pytest.mark.ci
@pytest.mark.parametrize("loss", [0.2, 0.4])
def test_expected_covariance_is_within_its_bounds(loss):
    """The error of an estimate has the covariance P+ with P = a^2 P+ + Q; far from the critical rate runs show its mean."""
    assert SCENARIOS[BASE].sampling.loss == 0.4
    study = {"name": "lost", "scenario": {"base": BASE, "loss": loss}, "seeds": 1024}
    stats = pcbench.run(study | {"options": {"scenario": {"random_initial_state": True}}}).stats
    row = stats[stats.metric == "steady_pooled_rmse"].iloc[0]
    low, high = (A**2 * (row["mean"] + side * 3 * row["se"]) ** 2 + Q for side in (-1, 1))
    S, V = bounds(1 - loss)
    assert low > S
    assert high < V
