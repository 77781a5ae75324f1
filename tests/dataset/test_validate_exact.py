"""Simulated means are held against exact ones by Student's distance, and what varies in no run by rounding alone."""

import numpy as np
import pandas as pd
import pytest
from documents import PAGES, tables
from scipy.stats import norm
from scipy.stats import t as student

import pcbench
from pcbench import plots
from pcbench.dataset import validate_exact
from pcbench.errors import UserError


def rows(**columns):
    one = {
        "scenario": "s",
        "cell": 0,
        "observer": "o",
        "signal": "x",
        "metric": "mae",
        "n": 100,
        "exact_se": 0.0,
        "max_abs_error": 0.0,
    }
    many = len(columns["mean"])
    return validate_exact.compare_means(
        pd.DataFrame([one | {k: v[i] for k, v in columns.items()} for i in range(many)])
    )


def test_a_distance_is_students_as_a_normal_number():
    found = rows(mean=[1.3, 0.9], se=[0.1, 0.1], exact=[1.0, 1.0])
    known = norm.isf(student.sf([3.0, -1.0], 99))
    np.testing.assert_allclose(found.z, known, rtol=1e-9)


def test_the_error_of_schedules_counts_too():
    assert rows(mean=[1.5], se=[0.3], exact=[1.0], exact_se=[0.4]).z[0] == pytest.approx(norm.isf(student.sf(1.0, 99)))


def test_runs_that_do_not_vary_must_be_equal_and_zero_is_zero():
    found = rows(
        mean=[1.0 + 1e-12, 1.001, 1e-14, 1e-28], se=[0.0, 0.0, 1e-17, 1e-31], exact=[1.0, 1.0, 2e-14, 2e-28],
        metric=["mae", "mae", "final_error", "steady_mse"],
    )  # fmt: skip
    assert found.z.isna().all()
    assert (found.deviation > validate_exact.ROUNDING).tolist() == [False, True, False, False]


def test_what_decays_from_a_large_error_ends_in_the_rounding_of_that():
    """A tank's enthalpy, from 3e4: 5e-11 is zero there; 1e-8 that came from 1 is known to the rounding of 1."""
    columns = {"metric": ["steady_mae", "steady_mse", "final_error", "final_error", "mse"], "se": [0.0] * 5}
    columns |= {
        "mean": [5.4e-11, 3.2e-21, 1e-8, 1e-8, 4.0],
        "exact": [4.9e-11, 2.9e-21, 1e-8 + 3e-17, 1.00001e-8, 4.0001],
    }
    found = rows(**columns, max_abs_error=[3.2e4, 3.2e4, 1.0, 1.0, 3.2e4])
    assert (found.deviation > validate_exact.ROUNDING).tolist() == [False, False, False, True, True]


def validation(z):
    table = rows(mean=list(1 + 0.1 * np.asarray(z)), se=[0.1] * len(z), exact=[1.0] * len(z), n=[10**6] * len(z))
    return validate_exact.ExactValidation(table, [], 4.0)


def test_the_verdict_names_what_chance_does_not_allow():
    good, bad = validation([0.5, -2.5, 1.0, 0.1]), validation([0.5, 5.0])
    assert good.wrong.empty
    assert "25 % of |z| above 2" in good.verdict
    assert "none differs more than chance allows" in good.verdict
    assert len(bad.wrong) == 1
    assert "1 differ more" in bad.verdict


def test_the_quantile_plot_has_a_point_for_every_mean():
    (ax,) = plots.quantiles(validation([0.5, -2.5, 1.0])).axes
    points = np.vstack([c.get_offsets() for c in ax.collections])
    np.testing.assert_allclose(sorted(points[:, 1]), [-2.5, 0.5, 1.0], rtol=1e-4)
    np.testing.assert_allclose(sorted(points[:, 0]), norm.ppf([1 / 6, 0.5, 5 / 6]), atol=1e-12)


@pytest.mark.nightly
def test_the_cart_passes_and_exact_results_have_nothing_to_compare(tmp_path):
    axes = {"delay": [0.2, 0.6], "parameter_drift": [0.0, 1.0]}
    pcbench.run("cart/gaussian", seeds=512, axes=axes, out=tmp_path / "runs")
    found = validate_exact.check(tmp_path / "runs")
    assert found.wrong.empty, found.wrong
    assert len(found.z) > 50
    pcbench.run("cart/gaussian", evaluation="exact", observers=["kf"], out=tmp_path / "exact")
    with pytest.raises(UserError, match="has no runs to be compared"):
        validate_exact.check(tmp_path / "exact")


@pytest.mark.nightly
@pytest.mark.parametrize(("study", "count"), tables(PAGES["exact_evaluation.md"], "study | means compared"))
def test_the_means_of_a_built_in_study_are_its_exact_values(study, count, tmp_path):
    pcbench.run(study, out=tmp_path / "out")
    found = validate_exact.check(tmp_path / "out")
    assert len(found.rows) == int(count.replace(",", ""))
    assert found.wrong.empty, found.wrong
