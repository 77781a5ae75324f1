"""Samples that are rounded, with subtractive dither and without: which values, by draws of their own, and of what error."""

import jax.numpy as jnp
import numpy as np
import pytest
from honest import STUDY
from reference import threefry
from scipy import stats

import pcbench
from pcbench.errors import UserError
from pcbench.simulation import measurements

pytestmark = pytest.mark.usefixtures("in_a_hurry")
PLAIN = STUDY | {"observers": ["kf"], "options": {}}
TICKS = np.arange(3, 61, 5)  # a sample every 5 ticks, 3 ticks late


def rounding_study(step, dither=0.0, **given):
    return PLAIN | {"lti": PLAIN["lti"] | {"quantization_step": step, "dither": dither} | given}


@pytest.mark.ci
@pytest.mark.parametrize("dither", [0.0, 1.0])
def test_samples_are_whole_steps_of_what_they_were_and_all_else_is_as_without(dither):
    without, found = (pcbench.simulate(s, "kf", seed=4) for s in (PLAIN, rounding_study([0.25], dither)))
    np.testing.assert_array_equal(found[["a", "b"]], without[["a", "b"]])
    y, got = (trace["y1"].to_numpy()[TICKS] for trace in (without, found))
    u = np.array([threefry.uniform(0, 4, "dither", 0, i, 1)[0] for i in range(len(TICKS))])
    d = dither * 0.25 * (u - 0.5)
    np.testing.assert_allclose(got, 0.25 * np.floor((y + d) / 0.25 + 0.5) - d, rtol=0, atol=1e-12)
    assert (np.abs(got - y) <= 0.125 + 1e-12).all()
    assert np.allclose(got % 0.25, 0.0) == (dither == 0.0)


def error(y, step, dither):
    """Of every sample y [K], each a channel of its own."""
    uniform = jnp.asarray(np.random.default_rng(5).uniform(size=y.shape))
    r = measurements.Rounding(jnp.full(y.shape, step), jnp.asarray(dither))
    return np.asarray(measurements.quantize(r, jnp.asarray(y), uniform)) - y


@pytest.mark.parametrize("signal", ["constant", "ramp", "sine"])
def test_with_subtractive_dither_the_error_is_uniform_over_a_step_whatever_is_measured(signal):
    """Of 100,000 samples: Kolmogorov and Smirnov's p above 0.01 for these draws; D^2/12 within four of its errors."""
    k, step = np.arange(100_000), 0.4
    y = {"constant": np.full(k.size, 0.07), "ramp": 1e-6 * k, "sine": 0.1 * np.sin(0.01 * k)}[signal]
    e = error(y, step, 1.0)
    assert stats.kstest(e, stats.uniform(-step / 2, step).cdf).pvalue > 0.01
    fourth = step**4 / 80 - (step**2 / 12) ** 2
    assert abs(np.mean(e**2) - step**2 / 12) < 4 * np.sqrt(fourth / k.size)
    if signal != "constant":
        assert abs(np.corrcoef(e, y)[0, 1]) < 4 / np.sqrt(k.size)


def test_without_dither_what_is_smaller_than_a_step_is_lost():
    y = 0.1 * np.sin(0.01 * np.arange(1000))
    np.testing.assert_allclose(error(y, 0.4, 0.0), -y, rtol=0, atol=1e-15)


@pytest.mark.ci
def test_a_step_of_0_is_none():
    np.testing.assert_array_equal(error(np.linspace(-1, 1, 7), 0.0, 1.0), np.zeros(7))


@pytest.mark.nightly
def test_of_dithered_samples_a_filter_that_is_told_their_variance_knows_how_wrong_it_is():
    """D^2/12 beside the noise's own: with the scale that says so its nis is near 1; told nothing it is optimistic."""
    axes = {"assumed_noise_scale": [1.0, float(np.sqrt(1 + 1.5**2 / 12 / 0.3**2))]}
    study = rounding_study([1.5], 1.0) | {"options": {"scenario": {"random_initial_state": True, "consistency": True}}}
    found = pcbench.run(study, axes=axes, seeds=256).stats
    unaware, told = found[found.metric == "nis"].sort_values("assumed_noise_scale")["mean"]
    assert unaware > 2.0
    assert told == pytest.approx(1.0, abs=0.06)


@pytest.mark.nightly
def test_of_it_there_is_no_bound_and_no_exact_answer_and_a_run_among_others_is_the_run_alone():
    study = rounding_study([0.5], 1.0, loss=0.2, delay_jitter=0.4)
    runs = pcbench.run(study, seeds=3).runs.set_index(["seed", "signal"])
    for seed in range(3):
        trace = pcbench.simulate(study, "kf", seed=seed)
        assert runs.loc[(seed, "a"), "final_error"] == pytest.approx((trace["a"] - trace["kf.a"])[59], rel=1e-9)
    assert "rms_efficiency" not in set(pcbench.run(rounding_study([0.5]), seeds=2).stats.metric)
    (why,) = set(pcbench.exact_moments(rounding_study([0.5])).stats.reason.dropna())
    assert "has samples that are rounded, which is not affine in what is measured; use runs for it" in why


REFUSED = [
    (rounding_study([-1.0]), "expected a number of at least 0"),
    (rounding_study([float("nan")]), "finite number"),
    (rounding_study([0.1, 0.2]), "got 2 values, expected one or 1"),
    (rounding_study([0.1], 0.5), "expected 1 \\(with subtractive dither\\) or 0"),
    (rounding_study([], 1.0), "got dither = 1 in lti, whose samples are not rounded"),
]


@pytest.mark.parametrize(("study", "sentence"), REFUSED, ids=[row[1] for row in REFUSED])
def test_what_cannot_be_is_one_sentence(study, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        pcbench.run(study, seeds=1)
    assert "\n" not in str(caught.value)


def test_an_axis_of_it_is_refused_where_nothing_is_sampled():
    with pytest.raises(UserError, match=r"got quantization_step = 0\.1 in arm/sine, whose measurements are continuous"):
        pcbench.run("arm/sine", axes={"quantization_step": [0.1]}, seeds=1)
