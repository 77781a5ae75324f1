"""Samples that are outliers: which, by draws of their own, and what everybody is told of it, which is nothing."""

import numpy as np
import pytest
from honest import STUDY
from reference import threefry

import pcbench
from pcbench.errors import UserError

pytestmark = pytest.mark.usefixtures("in_a_hurry")
PLAIN = STUDY | {"observers": ["kf"], "options": {}}


def odd(**given):
    return PLAIN | {"lti": PLAIN["lti"] | {"outlier_probability": 0.3, "outlier_scale": 7.0} | given}


@pytest.mark.ci
def test_outliers_are_the_samples_that_the_address_says_and_all_else_is_as_without():
    """Every 5 ticks a sample, 3 ticks late; the plant's own noise, start and samples are those of the study without."""
    without, found = pcbench.simulate(PLAIN, "kf", seed=4), pcbench.simulate(odd(), "kf", seed=4)
    np.testing.assert_array_equal(found[["a", "b"]], without[["a", "b"]])
    ticks = np.arange(3, 61, 5)
    apart = (found["y1"] - without["y1"]).to_numpy()[ticks]
    w = np.array([threefry.normal(0, 4, "measurement", 0, i) for i in range(len(ticks))])
    u = np.array([threefry.uniform(0, 4, "outlier", 0, i, 1)[0] for i in range(len(ticks))])
    np.testing.assert_allclose(apart, np.where(u < 0.3, 6.0 * 0.3 * w, 0.0), rtol=0, atol=1e-10)
    assert 0 < (u < 0.3).sum() < len(u)


@pytest.mark.nightly
def test_a_run_among_others_on_a_schedule_of_its_own_is_the_run_alone():
    study = odd(loss=0.2, delay_jitter=0.4)
    runs = pcbench.run(study, seeds=3).runs.set_index(["seed", "signal"])
    for seed in range(3):
        trace = pcbench.simulate(study, "kf", seed=seed)
        assert runs.loc[(seed, "a"), "final_error"] == pytest.approx((trace["a"] - trace["kf.a"])[59], rel=1e-9)


@pytest.mark.ci
def test_outliers_of_the_usual_size_are_none():
    few = {"seeds": 4}
    a, b = pcbench.run(odd(outlier_scale=1.0), **few).runs, pcbench.run(PLAIN, **few).runs
    np.testing.assert_allclose(a.rmse, b.rmse, rtol=1e-13)


@pytest.mark.ci
def test_of_what_is_not_normal_there_is_no_bound_and_no_exact_answer():
    result = pcbench.run(odd(), seeds=2)
    assert "rms_efficiency" not in set(result.stats.metric)
    assert "rms_efficiency" in set(pcbench.run(PLAIN, seeds=2).stats.metric)
    (why,) = set(pcbench.exact_moments(odd()).stats.reason.dropna())
    assert "30 % are outliers, whose noise is not normal; use runs for it" in why


REFUSED = [
    ({"outlier_probability": 1.5}, "expected a probability from 0 to 1"),
    ({"outlier_probability": -0.1}, "expected a number of at least 0"),
    ({"outlier_probability": float("nan")}, "finite number"),
    ({"outlier_probability": 0.0}, "an outlier_probability of 0, so it has no effect"),
    ({"noise_std": [0.0]}, "whose samples have no noise, expected"),
]


@pytest.mark.parametrize(("given", "sentence"), REFUSED, ids=str)
def test_what_cannot_be_is_one_sentence(given, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        pcbench.run(odd(**given), seeds=1)
    assert "\n" not in str(caught.value)


def test_an_axis_of_them_is_refused_where_nothing_is_sampled():
    with pytest.raises(
        UserError, match=r"got outlier_probability = 0\.1 in arm/sine, whose measurements are continuous"
    ):
        pcbench.run("arm/sine", axes={"outlier_probability": [0.1]}, seeds=1)


@pytest.mark.ci
def test_as_an_axis_it_has_a_column_and_else_none():
    axes = {"outlier_probability": [0.0, 0.1]}
    stats = pcbench.run(PLAIN, seeds=2, axes=axes).stats
    assert sorted(set(stats.outlier_probability)) == [0.0, 0.1]
    assert "outlier_scale" not in stats
    mean = stats[(stats.metric == "steady_rmse") & (stats.signal == "a")].set_index("outlier_probability")["mean"]
    assert mean[0.1] != mean[0.0]
