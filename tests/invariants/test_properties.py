"""Claims that need no reference: what an error may not depend on, and what delay 0 means."""

import numpy as np
import pytest
from harness import CART, ELSEWHERE, ODD, Case, context_of, inputs, noise, starts, trace
from hypothesis import given, settings
from hypothesis import strategies as st

from pcbench.dynamics import linear
from pcbench.observers import DELAYS, LATE, NONLINEAR, OBSERVERS


@pytest.mark.ci
@settings(max_examples=10)
@given(te=st.integers(1, 200), d=st.integers(0, 300), seed=st.integers(0, 2**31 - 1))
def test_pccebo_error_does_not_depend_on_the_input(te, d, seed):
    still = Case(CART, te, d, ticks=400, u=np.zeros((401, 1)), noise_std=0.5, seed=seed % 1000)
    moved = still._replace(u=np.random.default_rng(seed).normal(size=(401, 1)) * 10)
    errors = [got.x - got.estimates["pccebo"] for got in (trace(still, {"pccebo": {}}), trace(moved, {"pccebo": {}}))]
    np.testing.assert_allclose(*errors, rtol=0, atol=1e-11)


def test_kfbo_error_depends_on_the_input():
    still = Case(CART, 100, 100, u=np.zeros((901, 1)))
    moved = still._replace(u=np.ones((901, 1)))
    errors = [got.x - got.estimates["kfbo"] for got in (trace(still, {"kfbo": {}}), trace(moved, {"kfbo": {}}))]
    assert np.abs(errors[0] - errors[1]).max() > 0.01


@pytest.mark.ci
@pytest.mark.parametrize("model", [CART, ODD], ids=["cart", "odd"])
def test_delay_zero_equals_no_delay(model):
    """Without a network: the current estimator, corrected at the sampling tick itself, written out here."""
    case = Case(model, 50, 0, ticks=400, h=1e-3 if model is CART else 0.01, noise_std=0.3, seed=2)
    got = trace(case, {"pccebo": {}})
    L = OBSERVERS["pccebo"].design(context_of(case), OBSERVERS["pccebo"].options()).gains.L
    Phi, Gamma = linear.discretize_zoh(model.A, model.B, case.h)
    v, u, xhat, out = np.stack(noise(case), -1), inputs(case), starts(case)[1], []
    for k in range(case.ticks + 1):
        if k % case.te == 0:
            xhat = xhat + L @ (model.C @ got.x[k] + v[k // case.te] - model.C @ xhat)
        out.append(xhat)
        xhat = Phi @ xhat + Gamma @ u[k]
    np.testing.assert_allclose(got.estimates["pccebo"], out, rtol=0, atol=1e-10 * np.abs(got.x).max())


@pytest.mark.ci
def test_a_later_delay_shifts_what_is_known_and_nothing_else():
    """kf at delay d knows at tick k what kf at delay 0 knew at k - d, carried forward by the model."""
    now = Case(ODD, 20, 0, ticks=300, h=0.01, noise_std=0.2)
    late = now._replace(d=37)
    a, b = (trace(case, {"kf": {}}) for case in (now, late))
    Phi, Gamma = linear.discretize_zoh(ODD.A, ODD.B, 0.01)
    u = inputs(now)
    for k in range(37, 301):
        x = a.estimates["kf"][k - 37]
        for j in range(k - 37, k):
            x = Phi @ x + Gamma @ u[j]
        np.testing.assert_allclose(b.estimates["kf"][k], x, rtol=0, atol=1e-10 * np.abs(a.x).max())


@pytest.mark.ci
def test_nothing_is_known_before_the_first_arrival():
    case = Case(CART, 26, 130, ticks=300, noise_std=1.0)  # whole samples, as some need them
    got = trace(case, {name: {} for name in OBSERVERS if name not in (*ELSEWHERE, *LATE, *NONLINEAR, *DELAYS, "ekf")})
    for name, xhat in got.estimates.items():
        np.testing.assert_allclose(xhat[:130], got.estimates["model-only"][:130], rtol=0, atol=1e-12, err_msg=name)
