"""Exact second moments: Monte Carlo means agree with the propagated covariance within four standard errors.

The reference propagates mean and covariance of the error without a single random draw.
"""

import numpy as np
import pytest
from harness import CART, ODD, Case, noise, trace
from reference import cart, linear, long_digits, moments

import pcbench
from pcbench.dynamics import linear as synthesis
from pcbench.scenarios import SCENARIOS
from pcbench.synthesis import riccati

OBSERVED = ["pccebo", "kfbo", "kf"]


def agree(scenario, seeds, observers):
    result = pcbench.run(scenario, observers=observers, seeds=seeds)
    rows = result.stats.query("signal == 'position'").set_index(["observer", "metric"])
    s = SCENARIOS[scenario]
    for observer in observers:
        mean, variance = moments.cart_moments(moments.cart_map(scenario, observer), s.sampling.noise_std[0])
        want = {
            "mae": moments.expected_mae(mean, variance)[0],
            "steady_mae": moments.expected_mae(mean, variance, 3000)[0],
            "pooled_rmse": moments.root_expected_mse(mean, variance)[0],
            "steady_pooled_rmse": moments.root_expected_mse(mean, variance, 3000)[0],
        }
        for metric, value in want.items():
            row = rows.loc[(observer, metric)]
            assert abs(row["mean"] - value) < 4 * row["se"], (observer, metric)


@pytest.mark.nightly
def test_gaussian_scenario_agrees_with_the_propagated_covariance():
    agree("cart/gaussian", 2048, ["kf"])


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", ["cart/gaussian", "cart/gaussian-fast", "cart/white"])
def test_other_noise_scenarios_agree_with_the_propagated_covariance(scenario):
    agree(scenario, 4096, OBSERVED)


@pytest.mark.ci
@pytest.mark.parametrize("observer", OBSERVED)
def test_the_error_is_affine_in_the_noise(observer):
    """Superposition, the moments' only assumption, holds for the library's own runs."""
    options = {"kfbo": {"R": 0.5}}.get(observer, {})
    base = Case(CART, 60, 90, ticks=300, noise_std=1.0, seed=4, u=np.zeros((301, 1)), x0=[0.0, 0.0])
    if observer == "kf":
        options = {"R": 1.0}  # else the filter's R would follow the noise
    one, two = (trace(base._replace(noise_std=s), {observer: options}).estimates[observer] for s in (1.0, 2.0))
    np.testing.assert_allclose(two, 2 * one, rtol=0, atol=1e-12 * np.abs(one).max())
    assert np.abs(noise(base)[0]).max() > 0.5


def at_every_tick(*given):
    """The bound of each tick by itself; over all of them, and over some, it is their mean."""
    *given, ticks = given
    steps = riccati.no_steps()

    def over(first, last):
        return riccati.posterior_variance(*given, range(first, last), steps)

    each = np.stack([over(k, k + 1) for k in range(ticks)])
    for first, last in ((0, ticks), (ticks // 3, ticks), (1, ticks // 2)):
        np.testing.assert_allclose(over(first, last), each[first:last].mean(0), rtol=1e-12)
    return each


@pytest.mark.ci
@pytest.mark.parametrize(("te", "d"), [([60, 60], [60, 60]), ([40, 25], [130, 40]), ([50, 50], [0, 20])])
def test_the_bound_with_process_noise_equals_the_reference_recursion(te, d):
    """Noise that is added between samples, on the way to the present, and before the first; two sensors of their own times."""
    P0, R, ticks, h = np.diag([1.0, 4.0, 9.0]), np.array([0.6, 0.2]), 300, 0.01
    W = 0.3 * ODD.B @ ODD.B.T
    doubled = synthesis.doublings(ODD, h, synthesis.bits_for(ticks))
    noise = synthesis.noise_doublings(ODD, synthesis.input_noise(ODD, 0.3, h), h, len(doubled))
    samples = [(taken + d[j], taken, j) for j in range(2) for taken in range(0, ticks + 1, te[j])]
    got = at_every_tick(doubled, noise, ODD.C, R, P0, samples, ticks)
    model = linear.Model(ODD.A, ODD.B, ODD.C, h)
    want = np.diagonal(moments.posterior_covariance(model, ticks, te, d, R, P0, W), axis1=1, axis2=2)
    np.testing.assert_allclose(got, want[:-1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("te", "d"), [(60, 60), (40, 130), (50, 0)])
def test_the_bound_equals_the_reference_recursion(te, d):
    P0, R, ticks = cart.P0, np.array([0.6]), 400
    doubled = synthesis.doublings(CART, 1e-3, synthesis.bits_for(ticks))
    samples = [(taken + d, taken, 0) for taken in range(0, ticks + 1, te)]
    got = at_every_tick(doubled, 0 * doubled, CART.C, R, P0, samples, ticks)
    model = linear.Model(CART.A, CART.B, CART.C, 1e-3)
    want = np.diagonal(moments.posterior_covariance(model, ticks, [te], [d], R, P0), axis1=1, axis2=2)
    np.testing.assert_allclose(got, want[:-1], rtol=1e-10, atol=1e-12)


def test_the_bound_has_the_same_bits_whatever_was_found_before():
    """Other periods, delays and horizons, samples that overtake: what they have found on their way is known by all it is of."""
    P0, R, h, steps = np.diag([1.0, 4.0, 9.0]), np.array([0.6, 0.2]), 0.01, riccati.no_steps()
    doubled = synthesis.doublings(ODD, h, 9)
    noise = synthesis.noise_doublings(ODD, synthesis.input_noise(ODD, 0.3, h), h, len(doubled))
    for ticks, te, d in [
        (300, [60, 60], [60, 60]),
        (300, [60, 60], [90, 90]),
        (300, [30, 60], [60, 60]),
        (400, [40, 25], [130, 40]),
        (100, [7, 7], [0, 20]),
    ]:
        samples = [(taken + d[j], taken, j) for j in range(2) for taken in range(te[j], ticks + 1, te[j])]
        given = (doubled, noise, ODD.C, R, P0, samples, range(ticks // 5, ticks))
        np.testing.assert_array_equal(
            riccati.posterior_variance(*given, steps=steps), riccati.posterior_variance(*given)
        )


@pytest.mark.ci
@pytest.mark.parametrize("prior", [1e3, 1e5, 1e7])
def test_the_bound_keeps_its_digits_where_the_prior_is_far_larger_than_the_noise(prior):
    """Beside 80 digits; a recursion of P itself is off by 1e-4 of a prior 1e8 times the noise, and efficiency exceeds 1."""
    F, c, r, ticks = [[0.75, 0.125], [0.0, 1.0]], [1.0, 0.0], 1e-6, 60
    doubled, P0 = np.array([F]), prior**2 * np.eye(2)
    for _ in range(5):
        doubled = np.concatenate([doubled, [doubled[-1] @ doubled[-1]]])
    samples = [(tick, tick, 0) for tick in range(ticks)]
    given = (doubled, 0 * doubled, np.array([c]), np.array([r]), P0, samples)
    want = long_digits.posterior_variances(F, c, P0.tolist(), r, ticks)
    got = [riccati.posterior_variance(*given, range(k, k + 1)) for k in range(ticks)]
    np.testing.assert_allclose(got[2:], want[2:], rtol=1e-15 * prior / np.sqrt(r) + 1e-12)
