"""The finite-time observer: zero error after N samples, the weights of the source, and what they cost."""

import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, problem, recorder, trace
from scipy.linalg import expm

from pcbench.dynamics import linear
from pcbench.errors import DesignError, UserError
from pcbench.observers import OBSERVERS
from pcbench.synthesis import finite_time

A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
F1, F2 = (A - np.array([[a + b], [a * b]]) @ C for a, b in ((1.0, 2.0), (3.0, 4.0)))  # poles -1, -2 and -3, -4
INTEGRATORS = linear.Model(A, np.array([[0.0], [2.0]]), C)


def design(case, **options):
    return OBSERVERS["finite-time"].design(context_of(case), OBSERVERS["finite-time"].options(**options))


@pytest.mark.parametrize(("D", "printed"), [(0.05, "1.29e+05"), (0.5, "192"), (2.0, "5.42")])
def test_weights_of_the_continuous_observer_have_the_printed_norm(D, printed):
    K1, K2 = finite_time.weights(expm(F1 * D), expm(F2 * D))
    assert f"{np.linalg.norm(np.hstack([K1, K2]), 2):.3g}" == printed
    E, M = np.vstack([np.eye(2)] * 2), np.vstack([expm(F1 * D), expm(F2 * D)])
    source = np.hstack([np.eye(2), np.zeros((2, 2))]) @ np.linalg.inv(np.hstack([E, M]))
    np.testing.assert_allclose(np.hstack([K1, K2]), source, rtol=1e-8)


def test_error_of_the_continuous_observer_is_zero_from_D_on():
    """Both errors start alone, each from its own: e_i(t) = exp(F_i t) e_i(0), D = 1."""
    K1, K2 = finite_time.weights(expm(F1), expm(F2))
    np.testing.assert_allclose(K1 + K2, np.eye(2), atol=1e-15)
    np.testing.assert_allclose(K1 @ expm(F1) + K2 @ expm(F2), 0, atol=1e-15)
    first, second = np.array([1.0, -2.0]), np.array([0.3, 0.7])
    for t in (1.0, 1.3, 4.0):
        z1, z2 = (expm(F * t) @ e - expm(F) @ expm(F * (t - 1)) @ e for F, e in ((F1, first), (F2, second)))
        assert np.abs(K1 @ z1 + K2 @ z2).max() < 1e-13


@pytest.mark.ci
@pytest.mark.parametrize(("te", "d"), [(20, 0), (20, 35), (15, 60)])
@pytest.mark.parametrize(("samples", "pole"), [(2, 0.6), (4, 0.6), (9, 0.8)])
def test_error_is_zero_from_the_arrival_of_sample_N_on(samples, pole, te, d):
    case = Case(INTEGRATORS, te, d, ticks=400, h=0.01, x0=[5.0, -3.0])
    got = trace(case, {"finite-time": {"samples": samples, "pole": pole}})
    error = np.abs(got.x - got.estimates["finite-time"]).max(1)
    there = samples * te + d
    assert error[there - 1] > 1e-3
    assert error[there:].max() < 1e-10 * np.abs(got.x).max()


@pytest.mark.ci
def test_error_of_several_outputs_is_zero_from_the_arrival_of_sample_N_on():
    case = Case(ODD, 20, 30, ticks=300, h=0.01)
    got = trace(case, {"finite-time": {"samples": 3}})
    error = np.abs(got.x - got.estimates["finite-time"]).max(1)
    assert error[3 * 20 + 29] > 1e-3
    assert error[3 * 20 + 30 :].max() < 1e-10 * np.abs(got.x).max()


@pytest.mark.ci
def test_fast_mode_of_the_cart_vanishes_at_its_own_rate():
    case = Case(CART, 60, 0, ticks=900, x0=[5.0, 100.0])
    got = trace(case, {"finite-time": {"samples": 4}})
    error = np.abs(got.x - got.estimates["finite-time"])[::60].max(1)
    assert error[4] < 0.05 * error[3]
    assert error[6:].max() < 1e-8 * np.abs(got.x).max()


@pytest.mark.ci
def test_other_intervals_make_the_error_decay_instead_of_vanish():
    """Designed for another period than the true one, as where intervals vary: no error of zero, but one that decays."""
    case = Case(INTEGRATORS, 20, 0, ticks=800, h=0.01, x0=[5.0, -3.0], u=np.zeros((801, 1)))
    gains = design(case._replace(te=22)).gains
    layout, p = problem(case, {"finite-time": {}})
    got = recorder()(layout, p._replace(gains={"finite-time": gains}), np.asarray(0), np.asarray(0))
    error = np.abs(np.asarray(got.x) - np.asarray(got.estimates["finite-time"])).max(1)
    assert error[4 * 20] > 1e-4
    assert error[-1] < 1e-2 * error[4 * 20]


@pytest.mark.ci
@pytest.mark.parametrize(("te", "d"), [(40, 95), (7, 60), (50, 0)])
@pytest.mark.parametrize("odd", [False, True])
def test_perfect_start_leaves_no_error(te, d, odd):
    start = [1.0, -2.0, 0.5] if odd else [5.0, 10.0]
    case = Case(ODD if odd else CART, te, d, ticks=400, h=0.005 if odd else 1e-3, x0=start, xhat0=start)
    got = trace(case, {"finite-time": {}})
    assert np.abs(got.x - got.estimates["finite-time"]).max() < 1e-12 * np.abs(got.x).max()


def test_certificate_is_the_slower_radius_and_contains_what_is_left():
    certificate = design(Case(INTEGRATORS, 20, 0, h=0.01), pole=0.6).certificate
    assert certificate.margin == pytest.approx(0.4, abs=1e-6)  # a double pole is known to the root of rounding
    assert certificate.numbers["left"] < 1e-12


def test_too_few_samples_are_refused():
    case = Case(INTEGRATORS, 20, 0, h=0.01)
    with pytest.raises(UserError, match="got samples = 1, expected at least 2 for 2 states and 1 outputs"):
        design(case, samples=1)
    assert len(design(case, samples=2).gains.window) == 2


def test_weights_too_large_for_double_precision_are_refused():
    with pytest.raises(DesignError, match=r"got weights of size .* for 2 samples"):
        design(Case(INTEGRATORS, 1, 0, h=0.01), samples=2, pole=0.99, ratio=1.0000001)
