"""Noise with a heavy tail: Student's t of the same variance, on the draws of the normal noise and others beside them."""

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


def study_with_tail(degrees, **given):
    return PLAIN | {"lti": PLAIN["lti"] | {"student_t_dof": degrees} | given}


@pytest.mark.ci
@pytest.mark.parametrize("n", [2.5, 3.0, 7.0, 40.0])
def test_it_is_students_distribution_and_of_variance_one(n):
    """Of 50,000 draws by Kolmogorov and Smirnov's test: p above 0.01 for these seeds; and it goes to the normal as n grows."""
    w, z = np.random.default_rng(8).normal(size=(2, 50_000))
    v = np.asarray(measurements.student_t(jnp.asarray(w), jnp.asarray(z), jnp.asarray(n)))
    assert stats.kstest(v / np.sqrt((n - 2) / n), stats.t(n).cdf).pvalue > 0.01
    assert np.all(np.sign(v) == np.sign(w))
    normal = measurements.student_t(jnp.asarray(w), jnp.asarray(z), jnp.asarray(1e9))
    np.testing.assert_allclose(normal, w, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(measurements.student_t(jnp.asarray(w), jnp.asarray(z), jnp.asarray(np.inf)), w)


@pytest.mark.ci
def test_the_samples_are_those_of_the_addresses_and_all_else_is_as_without():
    without, found = pcbench.simulate(PLAIN, "kf", seed=4), pcbench.simulate(study_with_tail(3.0), "kf", seed=4)
    np.testing.assert_array_equal(found[["a", "b"]], without[["a", "b"]])
    ticks = np.arange(3, 61, 5)
    apart = (found["y1"] - without["y1"]).to_numpy()[ticks]
    w, z = (
        np.array([threefry.normal(0, 4, stream, 0, i) for i in range(len(ticks))]) for stream in ("measurement", "tail")
    )
    square = w**2 + z**2
    t = w * np.sqrt(3.0 * (np.exp(square / 3.0) - 1.0) / square)
    np.testing.assert_allclose(apart, 0.3 * (t * np.sqrt(1 / 3) - w), rtol=0, atol=1e-10)


@pytest.mark.nightly
def test_of_it_there_is_no_bound_and_no_exact_answer():
    assert "rms_efficiency" not in set(pcbench.run(study_with_tail(3.0), seeds=2).stats.metric)
    (why,) = set(pcbench.exact_moments(study_with_tail(3.0)).stats.reason.dropna())
    assert "noise is Student's t with 3 degrees, which is not normal; use runs for it" in why


REFUSED = [
    (study_with_tail(1.5), "expected more than 2 degrees of freedom"),
    (study_with_tail(-3.0), "expected a number of at least 0"),
    (study_with_tail(float("nan")), "finite number"),
    (study_with_tail(3.0, noise_std=[0.0]), "whose samples have no noise"),
]


@pytest.mark.parametrize(("study", "sentence"), REFUSED, ids=[row[1] for row in REFUSED])
def test_what_cannot_be_is_one_sentence(study, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        pcbench.run(study, seeds=1)
    assert "\n" not in str(caught.value)


def test_an_axis_of_it_is_refused_where_nothing_is_sampled():
    with pytest.raises(UserError, match=r"got student_t_dof = 3\.0 in arm/sine, whose measurements are continuous"):
        pcbench.run("arm/sine", axes={"student_t_dof": [3.0]}, seeds=1)
