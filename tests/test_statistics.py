"""The numbers over runs against SciPy, and against what is known of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from pcbench import statistics

RNG = np.random.default_rng(5)
A, B = RNG.gamma(3.0, size=60), RNG.gamma(3.3, size=60)
GOOD = np.zeros(60, bool)


def test_mean_interval_equals_scipy():
    got = statistics.mean(A)
    low, high = stats.t.interval(0.95, 59, loc=A.mean(), scale=stats.sem(A))
    assert (got["n"], got["mean"], got["se"]) == pytest.approx((60, A.mean(), stats.sem(A)))
    assert (got["ci_low"], got["ci_high"]) == pytest.approx((low, high))


def test_quantiles_equal_numpy():
    got = statistics.quantiles(A)
    assert [got[q] for q in ("p05", "p25", "p50", "p75", "p95")] == pytest.approx(np.percentile(A, [5, 25, 50, 75, 95]))


def test_pooled_interval_is_the_root_of_the_mean_squares_interval():
    low, high = stats.t.interval(0.95, 59, loc=A.mean(), scale=stats.sem(A))
    got = statistics.pooled(A)
    assert (got["mean"], got["ci_low"], got["ci_high"]) == pytest.approx(np.sqrt([A.mean(), low, high]))
    assert got["se"] == pytest.approx(stats.sem(A) / (2 * np.sqrt(A.mean())))


def test_efficiency_of_an_observer_at_the_bound_is_one():
    assert statistics.efficiency(np.array([3.9, 4.1]), 2.0)["mean"] == pytest.approx(1.0)
    worse = statistics.efficiency(np.array([99.0, 101.0]), 2.0)
    assert worse["mean"] == pytest.approx(0.2)
    assert worse["ci_low"] < worse["mean"] < worse["ci_high"]


def test_paired_test_equals_scipy():
    got, want = statistics.compare(A, B, GOOD, GOOD), stats.ttest_rel(A, B)
    assert got["p_value"] == pytest.approx(want.pvalue)
    ci = want.confidence_interval(0.95)
    assert (got["ci_low"], got["ci_high"]) == pytest.approx((ci.low, ci.high))
    assert got["prob_a_better"] == pytest.approx((A < B).mean())


def test_swapping_a_and_b_flips_the_sign_and_the_probability():
    one, two = statistics.compare(A, B, GOOD, GOOD), statistics.compare(B, A, GOOD, GOOD)
    assert one["mean_diff"] == pytest.approx(-two["mean_diff"])
    assert one["prob_a_better"] == pytest.approx(1 - two["prob_a_better"])


def test_diverged_runs_lose_and_are_never_averaged():
    bad = GOOD.copy()
    bad[:6] = True
    a = np.where(bad, np.nan, A)
    got = statistics.compare(a, B, bad, GOOD)
    assert got["n"] == 54
    assert got["mean_diff"] == pytest.approx((A - B)[6:].mean())
    assert got["prob_a_better"] == pytest.approx((A < B)[6:].sum() / 60)
    results = {m: np.stack([a]) for m in statistics.RUN_METRICS} | {"diverged": bad}
    for row in statistics.describe(results | {"unsettled": np.stack([GOOD])}, 0, None):
        assert row["diverged"] == 6
        assert row["n"] == (60 if row["metric"] == "divergence" else 54)
        assert np.isfinite(row["mean"])


def test_runs_that_do_not_vary_have_an_interval_without_width_and_no_test():
    same = np.full(9, 0.1)
    got = statistics.mean(same)
    assert (got["mean"], got["se"], got["ci_low"]) == (0.1, 0.0, 0.1)
    compared = statistics.compare(same, same + 1, GOOD[:9], GOOD[:9])
    assert compared["prob_a_better"] == 1.0
    assert np.isnan(compared["p_value"])


def test_rounding_is_a_tie():
    assert statistics.compare(A, A * (1 + 1e-12), GOOD, GOOD)["prob_a_better"] == 0.5


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_runs_have_no_interval(n):
    got = statistics.mean(A[:n])
    assert np.isnan([got["se"], got["ci_low"], got["ci_high"]]).all()


@settings(max_examples=80)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_equals_its_definition(p):
    """Reject in order of p while p_(i) <= alpha / (k - i): the adjusted value is the least alpha that rejects."""
    p = np.array(p)
    order = np.argsort(p, kind="stable")
    want = np.empty(len(p))
    for i, place in enumerate(order):
        want[place] = min(1.0, max((len(p) - j) * p[order[j]] for j in range(i + 1)))
    np.testing.assert_allclose(statistics.holm(p), want)


def test_holm_leaves_missing_tests_out():
    got = statistics.holm(np.array([0.01, np.nan, 0.03]))
    np.testing.assert_allclose(got, [0.02, np.nan, 0.03])


def test_holm_families_are_one_scenario_signal_and_metric_over_all_cells():
    names = [(s, g, m) for s in "ab" for g in "xy" for m in ("mae", "rmse")]
    rows = [
        {"scenario": s, "signal": g, "metric": m, "cell": cell, "p_value": 0.001 * (1 + i + 8 * cell)}
        for cell in range(2)
        for i, (s, g, m) in enumerate(names)
    ]
    for i, row in enumerate(statistics.adjusted(rows)):
        small, large = 0.001 * (1 + i % 8), 0.001 * (9 + i % 8)
        assert row["p_holm"] == pytest.approx(2 * small if row["cell"] == 0 else max(2 * small, large))


def test_rounding_of_zero_is_no_difference():
    """Errors of 1e-13 m and 1e-15 m on a signal of metres are both zero: a tie, and no test."""
    tiny = RNG.normal(size=60) * 1e-15
    got = statistics.compare(np.abs(tiny), np.abs(tiny) + 4e-13, GOOD, GOOD, floor=5e-11)
    assert got["prob_a_better"] == 0.5
    assert np.isnan(got["p_value"])


@pytest.mark.slow
def test_intervals_cover():
    """2000 experiments of 40 runs of a skewed metric: 95 % intervals cover 93 to 97 % of the time."""
    draws = RNG.gamma(4.0, size=(2000, 40))
    inside = [(m := statistics.mean(d))["ci_low"] < 4.0 < m["ci_high"] for d in draws]
    assert 0.93 < np.mean(inside) < 0.97
