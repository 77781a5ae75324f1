"""Calibration: coverage and PIT are those of scipy, bands are binomial, and a filter with a wrong covariance leaves them."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text
from scipy import stats

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import calibration_curves
from pcbench.report import captions

STUDY = {
    "name": "calibration",
    "scenarios": ["cart/gaussian"],
    "observers": ["kf", "kf-small", "pccebo"],
    "seeds": 100,
    "options": {"scenario": {"consistency": True, "random_initial_state": True}, "kf-small": {"R": 0.04}},
}


@pytest.fixture(scope="module")
def result():
    return pcbench.run(STUDY)


@pytest.mark.ci
def test_transform_is_chi_square_distribution_of_nees(result):
    found = calibration_curves.transforms_of(result)
    assert list(found) == ["kf", "kf-small"]
    for observer, values in found.items():
        runs = result.runs.query("signal == 'position' and observer == @observer")
        np.testing.assert_allclose(
            values, np.sort(stats.chi2.cdf(runs.nees * runs.nees_dof, runs.nees_dof)), rtol=1e-10, atol=1e-13
        )


@pytest.mark.ci
def test_true_covariance_is_in_the_band_and_small_one_is_optimistic(result):
    found = calibration_curves.transforms_of(result)
    assert stats.kstest(found["kf"], "uniform").pvalue > 0.01
    assert stats.kstest(found["kf-small"], "uniform").pvalue < 1e-6
    assert found["kf-small"].mean() > 0.6
    text = captions.calibration(found)
    for observer, values in found.items():
        assert f"{observer} {100 * np.mean(values <= 0.95):.3g} %" in text
    assert "100 runs" in text


@pytest.mark.ci
def test_figure_shows_coverage_histogram_and_binomial_bands(result):
    found, figure = calibration_curves.transforms_of(result), plots.calibration(result)
    left, right = figure.axes
    drawn = {line.get_label(): line for line in left.get_lines() if not line.get_label().startswith("_")}
    for observer, values in found.items():
        x, y = drawn[observer].get_data()
        np.testing.assert_allclose(y, [np.mean(values <= c) for c in x])
        counts = np.histogram(values, 10, (0, 1))[0]
        assert any(
            np.allclose(patch.get_data().values, counts / 100 * 10)
            for patch in right.patches
            if hasattr(patch, "get_data")
        )
    band = left.collections[0].get_paths()[0].vertices
    for nominal in (0.1, 0.5, 0.9):
        ends = band[np.isclose(band[:, 0], nominal)][:, 1]
        assert {*ends} == {*(stats.binom.ppf([0.025, 0.975], 100, nominal) / 100)}
    said = " ".join(t.get_text().replace("\n", " ") for t in figure.findobj(Text))
    for part in ("100 runs", "nominal coverage", "actual coverage", "PIT", "95 % band"):
        assert part in said


def test_bands_contain_filters_with_true_covariance():
    """Of 2,000 filters with a true covariance, each point of the curve leaves its band in at most 5 %."""
    rng, n = np.random.default_rng(4), 64
    low, high = stats.binom.ppf([[0.025], [0.975]], n, calibration_curves.NOMINAL) / n
    outside = [
        (c < low) | (c > high) for c in (calibration_curves.coverage(np.sort(rng.random(n))) for _ in range(2000))
    ]
    assert np.mean(outside, 0).max() < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 2000)


def test_diverged_runs_and_states_known_exactly_are_left_out():
    rows = [("kf", i, "x", i == 0, 1.0 + i, 2.0 * (i != 1)) for i in range(5)]
    runs = pd.DataFrame(rows, columns=["observer", "seed", "signal", "diverged", "nees", "nees_dof"])
    numbers = pd.DataFrame({"metric": ["nees"], "cell": [0], "method": ["runs"], "mean": [1.0], "observer": ["kf"]})
    named = SimpleNamespace(scenarios=["s"], signals=lambda s: ["x"], study=SimpleNamespace(name="t"))
    named.stats_of, named.runs_of = (lambda s, signal: numbers), (lambda *given: runs)
    found = calibration_curves.transforms_of(named)
    np.testing.assert_allclose(found["kf"], stats.chi2.cdf([6.0, 8.0, 10.0], 2.0))


@pytest.mark.ci
def test_without_covariance_there_is_no_figure():
    result = pcbench.run(STUDY | {"observers": ["pccebo", "kfbo"], "options": {}, "seeds": 2})
    with pytest.raises(UserError, match="with NEES"):
        plots.calibration(result)
