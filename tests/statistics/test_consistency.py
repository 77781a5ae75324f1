"""Who knows how wrong it is: bands, shares and verdicts, against draws whose covariance is known."""

import jax.numpy as jnp
import numpy as np
import pytest
from honest import STUDY as HONEST
from scipy.stats import t as student

import pcbench
from pcbench.errors import UserError
from pcbench.moments import nees
from pcbench.scenarios import SCENARIOS
from pcbench.simulation.innovation_stats import normalize_error
from pcbench.statistics.consistency import INSIDE, Band, band, exact_band, inside, verdict

P = np.array([[2.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 0.5]])
pytestmark = pytest.mark.usefixtures("in_a_hurry")
DRAWS = np.random.default_rng(5).normal(size=(400, 64, 3)) @ np.linalg.cholesky(P).T


@pytest.mark.parametrize(("n", "runs", "low", "high"), [(2, 256, 0.881, 1.126), (4, 1024, 0.957, 1.044)])
def test_the_bands_worked_out_beforehand(n, runs, low, high):
    assert band(n * runs) == pytest.approx((low, high), abs=6e-4)


@pytest.mark.ci
def test_normalised_squares_are_those_of_the_inverse_and_leave_out_what_is_known():
    e = DRAWS[0, 0]
    found = normalize_error(jnp.asarray(e), jnp.asarray(P), jnp.ones(3))
    assert found.nees == pytest.approx(e @ np.linalg.solve(P, e) / 3, rel=1e-12)
    np.testing.assert_allclose(found.signal, e**2 / np.diag(P), rtol=1e-12)
    known = P * np.outer([1.0, 1e-12, 1.0], [1.0, 1e-12, 1.0])
    less = normalize_error(jnp.asarray(e), jnp.asarray(known), jnp.ones(3))
    two = np.ix_([0, 2], [0, 2])
    assert less.states == 2
    assert less.nees == pytest.approx(e[[0, 2]] @ np.linalg.solve(P[two], e[[0, 2]]) / 2, rel=1e-12)
    assert np.isnan(less.signal).tolist() == [False, True, False]


def test_normalised_squares_of_a_singular_covariance_are_those_of_its_pseudo_inverse():
    """Three states that depend on two unknown numbers; rounding of 1e-14 leaves the rank as it is."""
    G, w = np.array([[2.0, 0.0], [0.5, 1.0], [-1.0, 0.3]]), np.array([0.7, -1.1])
    rounding = 1e-14 * np.diag([1.0, -1.0, 1.0])
    known = w @ w / 2
    assert G @ w @ np.linalg.pinv(G @ G.T) @ (G @ w) / 2 == pytest.approx(known, rel=1e-12)
    found = normalize_error(jnp.asarray(G @ w), jnp.asarray(G @ G.T + rounding), jnp.ones(3))
    assert (found.states, found.nees) == (2, pytest.approx(known, rel=1e-10))
    true = nees.FinalErrors(np.zeros((3, 1)), (G @ G.T)[..., None], (G @ G.T + rounding)[..., None], np.ones(3))
    exact = nees.squares(true)
    assert exact.states == 2
    np.testing.assert_allclose([*exact.nees[0], *exact.signal[:, 0]], 1.0, rtol=1e-10)


def share_of(covariance, word):
    """The share of 400 studies of 64 runs of which the verdict is this word."""
    means = np.einsum("sri,ij,srj->s", DRAWS, np.linalg.inv(covariance), DRAWS) / (64 * 3)
    return np.mean([verdict(mean, band(3 * 64)) == word for mean in means])


def test_a_true_covariance_is_called_inconsistent_in_one_study_of_twenty_and_half_of_one_in_nearly_all():
    assert 1 - share_of(P, "consistent") == pytest.approx(0.05, abs=0.035)  # three standard errors of 400
    assert share_of(P / 2, "optimistic") > 0.99
    assert share_of(P * 2, "pessimistic") > 0.99
    assert verdict(float("nan"), Band(0.9, 1.1)) == "unknown"
    assert [verdict(1 + off, exact_band()) for off in (-2e-6, -5e-7, 5e-7, 2e-6)] == [
        *("pessimistic", "consistent"),
        *("consistent", "optimistic"),
    ]


def test_shares_within_one_two_and_three_sigma_are_the_normal_ones():
    squares = np.random.default_rng(6).normal(size=(1, 100_000)) ** 2
    np.testing.assert_allclose(inside(squares)[:, 0] / 1e5, [0.6827, 0.9545, 0.9973], atol=0.005)


STUDY = {
    "name": "honest",
    "scenarios": ["cart/gaussian"],
    "observers": ["kf", "kf-bold", "kf-ignore-delay", "model-only"],
    "seeds": 192,
    "options": {"scenario": {"random_initial_state": True, "consistency": True}},
}


@pytest.mark.ci
def test_the_filter_with_a_true_model_is_consistent_with_a_quarter_of_the_noise_over_confident():
    options = STUDY["options"] | {"kf-bold": {"R": 0.25}}
    axes = {"noise_std": [1.0], "delay": [0.3]}
    result = pcbench.run(STUDY | {"options": options}, axes=axes)
    wide = result.stats.set_index(["signal", "metric", "observer"])[["mean", "ci_low", "ci_high"]]

    def word(observer):
        within = wide.loc["position", "nees_band", observer]
        return verdict(wide.loc["position", "nees", observer]["mean"], Band(within.ci_low, within.ci_high))

    assert [word(o) for o in ("kf", "kf-bold", "kf-ignore-delay")] == ["consistent", "optimistic", "optimistic"]
    assert wide.loc["position", INSIDE[0], "kf"]["mean"] == pytest.approx(0.683, abs=0.1)
    assert ("position", "nees", "model-only") not in wide.index, "it has no covariance"
    assert "nees" not in set(result.pairs.metric), "neither a large nor a small one is better"


def share_called(runs, metric, degrees, word):
    """The share of studies of 64 runs whose verdict by a metric is this word; degrees by run [n]."""
    studies = runs[metric].to_numpy().reshape(-1, 64).mean(1)
    within = [band(d) for d in (runs[degrees].to_numpy() if degrees else np.ones(len(runs))).reshape(-1, 64).sum(1)]
    return np.mean([verdict(mean, b) == word for mean, b in zip(studies, within, strict=True)])


@pytest.mark.nightly
def test_of_studies_of_a_true_model_one_in_twenty_is_called_inconsistent_of_a_quarter_of_the_noise_nearly_all():
    """256 studies of 64 runs; three standard errors of that share are .041."""
    runs = pcbench.run(HONEST | {"observers": ["kf", "kf-bold", "ekf", "kf-cloning"]}, seeds=64 * 256).runs
    runs = runs[runs.signal == "a"].sort_values("seed")
    for metric, degrees in (("nees", "nees_dof"), ("nis", "nis_dof"), ("signal_nees", None)):
        for observer in ("kf", "ekf", "kf-cloning"):
            mine = runs[runs.observer == observer]
            assert 1 - share_called(mine, metric, degrees, "consistent") == pytest.approx(0.05, abs=0.041), metric
        assert share_called(runs[runs.observer == "kf-bold"], metric, degrees, "optimistic") > 0.97


@pytest.mark.ci
@pytest.mark.parametrize(
    "names", [("kf",), pytest.param(("kf", "kf-cloning", "model-only"), marks=pytest.mark.nightly)]
)
def test_samples_are_judged_on_schedules_of_each_runs_own(names):
    """Lost, late and out-of-sequence samples: of a true model nis is 1, over all that arrive, in which runs differ."""
    lossy = {"lti": HONEST["lti"] | {"loss": 0.2, "delay_jitter": 0.8}}
    result = pcbench.run(HONEST | lossy | {"observers": list(names)}, seeds=64)
    runs = result.runs[result.runs.signal == "a"].set_index(["observer", "seed"])
    counts = runs.nis_dof
    assert counts["kf"].nunique() > 1
    if "kf-cloning" in names:
        assert counts["kf-cloning"].equals(counts["kf"]), "both judge every measurement that arrives"
        assert runs.nis["model-only"].isna().all()
    wide = result.stats[result.stats.signal == "a"].set_index(["observer", "metric"])
    for observer in names[:2]:
        row, degrees = wide.loc[(observer, "nis_band")], 64 * counts[observer].mean()
        assert (row.ci_low, row.ci_high) == pytest.approx(band(degrees))
        assert row.ci_low < wide.loc[(observer, "nis"), "mean"] < row.ci_high
        mine = runs.loc[observer]
        check_over_all(wide.loc[(observer, "nis")], mine.nis * mine.nis_dof, mine.nis_dof)


def check_over_all(row, squares, degrees):
    """All squares over all numbers, with the standard error of such a ratio (Cochran 1977, section 2.11)."""
    n, ratio = len(squares), squares.sum() / degrees.sum()
    se = np.sqrt(((squares - ratio * degrees) ** 2).sum() / (n - 1) / n) / degrees.mean()
    assert (row["mean"], row.se) == pytest.approx((ratio, se), rel=1e-10)
    ends = ratio * np.exp(np.array([-1, 1]) * student.ppf(0.975, n - 1) * se / ratio)
    assert (row.ci_low, row.ci_high) == pytest.approx(tuple(ends), rel=1e-10)


@pytest.mark.ci
def test_a_run_without_a_judged_sample_adds_nothing_to_the_mean_nis():
    """Nearly all samples are lost: some runs have none, and their own nis is unknown."""
    lossy = {"lti": HONEST["lti"] | {"loss": 0.93}}
    result = pcbench.run(HONEST | lossy | {"observers": ["kf"]}, seeds=64)
    runs = result.runs[(result.runs.signal == "a") & (result.runs.observer == "kf")]
    assert 0 < runs.nis.isna().sum() < 64
    assert ((runs.nis_dof == 0) == runs.nis.isna()).all()
    wide = result.stats[result.stats.signal == "a"].set_index(["observer", "metric"])
    check_over_all(wide.loc[("kf", "nis")], (runs.nis * runs.nis_dof).fillna(0.0), runs.nis_dof)
    within = wide.loc[("kf", "nis_band")]
    assert (within.ci_low, within.ci_high) == pytest.approx(band(runs.nis_dof.sum()))


def test_consistency_needs_starts_that_are_drawn():
    with pytest.raises(UserError, match="add random_initial_state = true"):
        pcbench.run(STUDY | {"observers": ["kf"], "options": {"scenario": {"consistency": True}}})


@pytest.mark.ci
def test_a_trace_has_the_standard_deviation_that_is_believed():
    """Before anything has arrived no less than the prior's, then less."""
    study = {"name": "t", "scenarios": ["cart/gaussian"], "options": STUDY["options"]}
    found = pcbench.simulate(study, ["kf", "model-only"])
    sigma = found["kf.position.sigma"]
    prior = SCENARIOS["cart/gaussian"].belief.prior_std[0]
    waits = found["y1"].isna().to_numpy()
    assert 0 < waits.sum() < len(waits) / 4
    assert (sigma[waits] >= prior).all()
    assert (sigma[~waits] < prior).all()
    assert "model-only.position.sigma" not in found
