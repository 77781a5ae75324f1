"""Estimators for nonlinear plants: each equals an independent reference, and on a linear plant Kalman's filter.

The linear plant and its schedules are those of `test_late_samples`; the nonlinear one is in `support/swinging`, where samples
are late, lost and overtaking, neither sensor is linear, and a parameter is estimated beside the state. Tolerances are rounding:
1e-10 of the signal's size.
"""

import driven
import numpy as np
import pytest
import swinging
from harness import inputs, starts
from reference import nonlinear as reference
from test_late_samples import CASE, KNOWN, TICKS, TIMES, optimum, plant, same
from test_late_samples import found as of_linear

from pcbench.errors import UserError
from pcbench.observers import OBSERVERS

CUBATURE = {"form": "cubature"}
LINEAR = [("iekf", {}), ("ukf", {}), ("ukf", CUBATURE)]


@pytest.mark.parametrize("schedule", TIMES)
@pytest.mark.parametrize(("name", "options"), LINEAR, ids=str)
def test_on_a_linear_plant_it_is_the_optimum_whatever_is_late_lost_or_overtaking(name, options, schedule):
    there = driven.traffic(TIMES[schedule], plant(schedule)[1], TICKS, 2)
    xhat, P, squares = driven.whole(name, KNOWN, options, there, inputs(CASE), starts(CASE)[1])
    same(xhat, optimum(schedule))
    same(P, of_linear("dkf", schedule)[1])
    best = driven.whole("dkf", KNOWN, {}, there, inputs(CASE), starts(CASE)[1])[2]
    np.testing.assert_allclose(squares, best, rtol=0, atol=1e-9 * best.max())


def agrees(got, want):
    states, squares = want
    same(got[0], np.array([z for z, _ in states]))
    same(got[1], np.array([P for _, P in states]))
    same(got[2], squares)
    assert squares[:, 1].sum() > 6


@pytest.mark.parametrize("iterations", [1, 4])
def test_iterating_equals_the_reference(iterations):
    want = reference.by_slopes(swinging.model(), *swinging.prior(), swinging.samples(), swinging.inputs(), iterations)
    agrees(swinging.found("iekf", iterations=iterations), want)


def test_iterating_once_is_the_extended_filter():
    for a, b in zip(swinging.found("iekf", iterations=1), swinging.found("ekf"), strict=True):
        same(a, b)
    assert np.abs(swinging.found("iekf", iterations=4)[0] - swinging.found("ekf")[0]).max() > 1e-3


WEIGHTS = [{"alpha": 0.6, "beta": 1.3, "kappa": 0.4}, {"alpha": 1.0, "beta": 2.0}]


@pytest.mark.parametrize("options", WEIGHTS, ids=str)
def test_unscented_points_equal_the_reference(options):
    want = reference.by_points(swinging.model(), *swinging.prior(), swinging.samples(), swinging.inputs(), **options)
    agrees(swinging.found("ukf", **options), want)


def test_cubature_points_equal_the_reference():
    want = reference.by_points(
        swinging.model(), *swinging.prior(), swinging.samples(), swinging.inputs(), cubature=True
    )
    agrees(swinging.found("ukf", **CUBATURE), want)


def test_a_start_that_is_known_has_no_points():
    """P0 = 0 and no process noise: the points are one, and nothing is divided by 0."""
    known = swinging.known(P0=np.zeros((2, 2)), process_std=(), unknown_std=(0.0,))
    xhat, P, _ = driven.whole("ukf", known, {}, swinging.traffic(), swinging.inputs(), swinging.START)
    z = np.append(swinging.START, swinging.P_START)
    for k, u in enumerate(swinging.inputs()):
        np.testing.assert_allclose(xhat[k], z, rtol=0, atol=1e-12)
        z = reference.rk4(swinging.rate, z, u, swinging.H)
    assert not P.any()


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("ukf", {"form": "cubature", "alpha": 0.3}, "got alpha beside form = 'cubature'"),
        ("ukf", {"kappa": -3.0}, "got kappa = -3 with 3 states and unknowns, expected more than -3"),
    ],
    ids=str,
)
def test_what_cannot_be_is_refused_in_a_sentence(name, options, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        OBSERVERS[name].design(swinging.known(), OBSERVERS[name].options(**options))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "option"),
    [("iekf", "iterations"), ("iekf", "walk"), ("ukf", "alpha"), ("ukf", "beta"), ("ukf", "R")],
)
@pytest.mark.parametrize("value", [-1, float("nan"), float("inf")])
def test_options_that_are_no_sizes_or_counts_are_refused(name, option, value):
    with pytest.raises(ValueError, match=option):
        OBSERVERS[name].options(**{option: value})
