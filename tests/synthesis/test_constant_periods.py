"""Limits of constant sampling periods: the high-gain observer of a chain, held gains, jumps, and their random intervals."""

import math

import numpy as np
import pytest
from reference import linear

from pcbench.dynamics.linear import spectral_radius
from pcbench.errors import DesignError
from pcbench.plants import flexible_joint, ncs_two_state
from pcbench.synthesis import constant_periods, sampled_high_gain

FORMS = ("hold", "predictor", "impulse")
# largest theta T of a chain of n = 2, 3, 4 integrators; 1, 4.99991 and 0.828 are of the source of this check, the others ours
LIMITS = {
    "hold": (1.0, 0.67522, 0.51113),
    "predictor": (4.99991, 2.89627, 1.28317),
    "impulse": (2 * (math.sqrt(2) - 1), 0.52753, 0.38757),
}
TIMER_A = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [-2, 1, -1, 0], [2, -2, 0, -2]])
TIMER_C = np.eye(4)[:1]
TIMER_L = np.array([[1.0], [-0.9433], [-0.6773], [1.6274]])


def reference_map(form, n, T):
    """The map of the error over T, with two holds of input instead of an exponential of the error's own flow."""
    A, C = np.eye(n, k=1), np.eye(n)[:1]
    L = np.array([math.comb(n, i + 1) for i in range(n)], float)[:, None]
    if form == "hold":
        Phi, Gamma = linear.discretise(A, -L, T)
        return Phi + Gamma @ C
    if form == "impulse":
        return linear.discretise(A, L, T)[0] @ (np.eye(n) - T * L @ C)
    wide = np.zeros((n + 1, n + 1))  # (e, error of the predicted output), which a sample sets to 0
    wide[:n, :n], wide[:n, n:], wide[n, 1] = A - L @ C, L, 1.0
    return linear.discretise(wide, np.zeros((n + 1, 1)), T)[0][:n, :n]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("interval", [0.03, 0.4, 1.7])
def test_error_map_of_a_chain_agrees_with_the_reference(form, n, interval):
    got = sampled_high_gain.error_map(form, n, interval)
    np.testing.assert_allclose(got, reference_map(form, n, interval), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_high_gain_has_its_largest_constant_periods(form):
    found = [sampled_high_gain.limit(form, n) for n in (2, 3, 4)]
    np.testing.assert_allclose(found, LIMITS[form], atol=5e-6)
    for n, limit in zip((2, 3, 4), found, strict=True):
        below, above = (np.abs(np.linalg.eigvals(reference_map(form, n, limit * k))).max() for k in (0.999, 1.001))
        assert below < 1 < above


def test_decay_with_output_predictor_falls_from_that_of_the_continuous_observer():
    rates = [sampled_high_gain.decay_rate("predictor", 2, interval) for interval in (1e-3, 0.1, 0.5, 1.0, 2.0, 3.0)]
    assert rates[0] == pytest.approx(1.0, abs=1e-3)
    assert (rates[1], rates[-1]) == (pytest.approx(0.973, abs=5e-4), pytest.approx(0.232, abs=5e-4))
    assert rates == sorted(rates, reverse=True)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", [2, 3, 4])
def test_every_form_tends_to_the_continuous_observer_as_the_period_goes_to_0(form, n):
    # the error's rate of change over a short interval is that of e' = (A - L C) e, to first order of the interval
    A, L = np.eye(n, k=1), np.array([[math.comb(n, i + 1)] for i in range(n)], float)
    for interval in (1e-3, 1e-4):
        rate = (sampled_high_gain.error_map(form, n, interval) - np.eye(n)) / interval
        assert np.abs(rate - (A - L @ np.eye(n)[:1])).max() < 40 * interval


@pytest.mark.parametrize("shape", [(3, 1), (4, 2)])
def test_held_map_agrees_with_the_reference(shape):
    rng = np.random.default_rng(5)
    n, q = shape
    A, L, C = rng.normal(size=(n, n)), rng.normal(size=shape), rng.normal(size=(q, n))
    Phi, Gamma = linear.discretise(A, -L, 0.37)
    np.testing.assert_allclose(constant_periods.held_map(A, L, C, 0.37), Phi + Gamma @ C, rtol=1e-10, atol=1e-12)


def test_two_state_plant_has_its_largest_constant_period():
    model = ncs_two_state.nominal(ncs_two_state.Numbers())
    K = np.array([[3.75, 11.5]])
    found = constant_periods.largest_stable(
        lambda T: spectral_radius(constant_periods.held_map(model.A, model.B, K, T)), 3.0
    )
    assert found == pytest.approx(1.7294, abs=5e-5)


@pytest.mark.parametrize(
    ("gain", "limit"), [((4.375, 0.179, 4.071, 3.463), 0.4691), ((4.019, 0.901, 3.689, 3.505), 0.5043)]
)
def test_flexible_joint_has_its_largest_constant_period_over_all_slopes(gain, limit):
    models = [flexible_joint.nominal(flexible_joint.Numbers(gravity=slope)).A for slope in (-3.33, 0.0, 3.33)]
    L, C = np.array(gain)[:, None], np.eye(4)[:1]

    def radius(T):
        return max(spectral_radius(constant_periods.held_map(A, L, C, T)) for A in models)

    assert constant_periods.largest_stable(radius, 0.8) == pytest.approx(limit, abs=1e-4)


def test_held_gain_of_the_timer_example_has_the_period_pi_half():
    def held(T):
        return constant_periods.held_map(TIMER_A, TIMER_L, TIMER_C, T)

    assert spectral_radius(held(1.0)) == pytest.approx(0.9595, abs=5e-5)
    found = constant_periods.largest_stable(lambda T: spectral_radius(held(T)), 3.0)
    assert found == pytest.approx(math.pi / 2, abs=1e-6)


@pytest.mark.parametrize(("period", "radius"), [(0.2, 1.17), (1.5, 1.01), (2.0, 0.44), (3.0, 0.86)])
def test_jump_of_the_timer_example_is_unstable_at_short_periods_only(period, radius):
    M = constant_periods.jump_map(TIMER_A, TIMER_L, TIMER_C, period)
    assert spectral_radius(M) == pytest.approx(radius, abs=5e-3)


@pytest.mark.parametrize(("form", "exponent"), [("held_map", -0.057), ("jump_map", -0.35)])
def test_both_forms_of_the_timer_example_converge_over_random_intervals(form, exponent):
    """The mean of log |e(k+1)| / |e(k)| is below 0."""
    intervals = np.random.default_rng(0).uniform(0.2, 10.0, 2000)
    e, logs = np.random.default_rng(1).standard_normal(len(TIMER_A)), []
    for interval in intervals:
        e = getattr(constant_periods, form)(TIMER_A, TIMER_L, TIMER_C, float(interval)) @ e
        size = np.linalg.norm(e)
        e, logs = e / size, [*logs, np.log(size)]
    assert np.mean(logs) == pytest.approx(exponent, abs=0.02)  # four seeds lie within 0.01 of it


@pytest.mark.parametrize("radius", [lambda T: 0.5, lambda T: 1.5])
def test_search_without_a_limit_in_its_range_says_so(radius):
    with pytest.raises(DesignError, match="expected a limit"):
        constant_periods.largest_stable(radius, 1.0)
