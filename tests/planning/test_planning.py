"""The context of a design, and where there is a bound: for the true linear model, with all the noise there is."""

import numpy as np
import pytest
from reference import chain, linear, moments

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.observers import entry_of
from pcbench.scenarios import INTERVAL, SCENARIOS
from pcbench.study.grid import cell_of
from pcbench.study.schema import Choices


def cell(name, parameters=None, **changes):
    """A scenario with its fields changed, as a cell."""
    return cell_of(SCENARIOS[name].with_fields(**changes), parameters=parameters)


def bound(name, parameters=None, **changes):
    """The bound that stands in the tables of such a cell, or None."""
    return planning.draft(cell(name, parameters, **changes), {"model-only": entry_of("model-only").options()}).bound


def test_designers_believe_the_mean_age_of_samples_that_are_jittered():
    """A sample comes 0 .. 60 ticks later than the delay of 200: 230 on average; and as much older as they wrongly believe."""
    known = planning.context_of(cell("cart/white", delay_jitter=0.06))
    assert known.delay == (200 + np.arange(61).mean(),)
    assert planning.context_of(cell("cart/white", assumed_delay_error=0.05)).delay == (250,)
    mixed = planning.context_of(
        cell("csth/10s", delay_jitter=40.0, assumed_delay_error=10.0, delay=(20.0, INTERVAL, 70.0))
    )
    assert mixed.delay == (2 + 2 + 1, 1 + 2 + 1, 7 + 2 + 1)


def test_the_period_that_designers_believe_is_the_mean_of_intervals_in_turn():
    assert planning.context_of(cell("cart/variable", sampling_pattern=(0.1, 0.3, 0.5))).period == (300,)


def test_a_delay_reaches_back_to_the_sample_before_it():
    """Of samples every 0.2 s one of 0.5 s ago reaches three back, one of 0.4 s two."""
    assert planning.context_of(cell("cart/white", delay=(0.5,))).reach == 3
    assert planning.context_of(cell("cart/white", delay=(0.4,))).reach == 2


def test_observers_know_the_model_and_not_what_is_true_of_the_plant():
    known = planning.context_of(cell("cart/variable-gain", {"b": 390.5}))
    np.testing.assert_array_equal(known.model.B, [[0.0], [355.0]])
    np.testing.assert_array_equal(planning.context_of(cell("csth/literal")).model.A[2], [0, 0, -1.2019e-3])


BOUNDLESS = {
    "drift": ("cart/white", None, {"parameter_drift": 1.0}),
    "another parameter": ("cart/white", {"lam": 110.0}, {}),
    "random times": ("cart/white", None, {"loss": 0.1}),
    "a channel without noise": ("csth/10s", None, {"noise_std": (1.0, 0.0, 0.1)}),
    "an unknown input": ("arm/sampled", None, {"duration": 0.1, "steady_start": 0.05}),
    "a nonlinear plant": (
        "helicopter/constant",
        None,
        {"noise_std": (1e-3, 1e-3), "duration": 0.5, "steady_start": 0.2},
    ),
}


@pytest.mark.parametrize("what", BOUNDLESS)
def test_there_is_no_bound_where_observers_cannot_know_what_moves_the_plant(what):
    name, parameters, changes = BOUNDLESS[what]
    assert bound(name, parameters, **changes) is None


def test_a_start_drawn_from_a_box_has_no_bound():
    """The runs' starts are uniform, so a bound for normal ones is none; a start that is not drawn leaves the bound as it is."""
    boxed = SCENARIOS["cart/white"].with_fields(initial_box=(0.5, 0.5))
    found = {}
    for drawn in (True, False):
        one = cell_of(boxed, choices=Choices(random_initial_state=drawn))
        found[drawn] = planning.draft(one, {"model-only": entry_of("model-only").options()}).bound
    assert found[True] is None
    np.testing.assert_array_equal(found[False], bound("cart/white"))


def test_there_is_a_bound_where_a_parameter_is_what_observers_believe():
    np.testing.assert_array_equal(bound("cart/white", {"lam": 122.0}), bound("cart/white"))


def test_the_bound_is_the_root_of_the_mean_posterior_variance_over_the_tail():
    found = bound("cart/white", duration=2.0, steady_start=1.1, delay=(0.13,))
    model = linear.Model(
        np.array([[0.0, 1.0], [0.0, -122.0]]), np.array([[0.0], [355.0]]), np.array([[1.0, 0.0]]), 1e-3
    )
    P = moments.posterior_covariance(model, 2000, [200], [130], np.array([0.35]), np.diag([25.0, 100.0]))
    np.testing.assert_allclose(found, np.sqrt(np.diagonal(P, axis1=1, axis2=2)[1100:-1].mean(0)), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["csth/10s-noise", "csth/10s"])
def test_the_bound_knows_the_process_noise_that_there_is_and_not_what_designers_assume(name):
    """csth/10s has none, but designers assume some: it would raise the bound."""
    noise = (1.0, 0.1, 0.1)
    found = bound(name, noise_std=noise, duration=600.0, steady_start=200.0)
    Q, R, P0 = chain.csth_noise(10.0)
    Q = Q if SCENARIOS[name].truth.process_std else 0 * Q
    rest, silent = np.zeros((61, 2)), np.zeros((61, 3))
    _, P = chain.kalman(chain.csth("10s"), rest, chain.received(silent, [2, 5, 7]), [2, 5, 7], np.zeros(3), P0, Q, R)
    want = np.sqrt(np.diagonal(np.stack(P), axis1=1, axis2=2)[20:60].mean(0))
    np.testing.assert_allclose(found, want, rtol=1e-8)


def test_an_observer_is_told_the_prior_and_the_noise_as_variances():
    known = planning.context_of(cell("csth/10s-noise"))
    np.testing.assert_array_equal(known.P0, np.diag([0.25, 4e8, 25.0]))
    np.testing.assert_allclose(known.noise_variance, [1.0, 0.01, 0.01], rtol=1e-15)
    np.testing.assert_allclose(np.diag(known.process_noise), [1e-5, 2.5e4, 2.5e-4], rtol=1e-12)
    quiet = planning.context_of(cell("csth/10s", assumed_noise_std=()))
    np.testing.assert_array_equal(quiet.noise_variance, [1e-12] * 3)


def test_a_range_of_a_parameter_that_is_none_is_one_sentence():
    with pytest.raises(UserError, match="'lambda' is no parameter of plant cart; did you mean 'lam'"):
        pcbench.design("cart/white", "pccebo", overrides=["options.pccebo.parameter_range.lambda=[100.0, 130.0]"])
