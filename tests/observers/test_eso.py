"""The extended state observer: constant disturbances, wrong models, bandwidth and refusals."""

import jax.numpy as jnp
import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, inputs, noise, starts, trace
from reference import field_observers as reference
from reference.linear import Model, simulate

from pcbench.dynamics import linear
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS

INTEGRATORS = linear.Model(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [2.0]]), np.array([[1.0, 0.0]]))
TE = 20


def design_eso(case, **options):
    return OBSERVERS["eso"].design(context_of(case), OBSERVERS["eso"].options(**options))


def disturb(case, push):
    """The case with a plant that the input's disturbance moves: u + push(k) at tick k."""
    Phi, Gamma = linear.one_tick(case.model, case.h)
    u = inputs(case)
    each = np.array([(v + push(k)) / v for k, v in enumerate(u[:, 0])])  # Gamma u (1 + d/u)
    return case._replace(Phi=np.broadcast_to(Phi, (len(u), *Phi.shape)), Gamma=each[:, None, None] * Gamma, u=u)


@pytest.mark.parametrize("d", [0, 35])
def test_deadbeat_error_is_zero_after_three_samples_of_a_constant_disturbance(d):
    case = disturb(Case(INTEGRATORS, TE, d, ticks=200, h=0.01, x0=[5.0, -3.0]), lambda k: 0.7)
    got = trace(case, {"eso": {"pole": 0.0}})
    error = np.abs(got.x - got.estimates["eso"]).max(1)
    there = 2 * TE + d  # arrival of the third sample
    assert error[there - 1] > 0.1
    assert error[there:].max() < 1e-10 * np.abs(got.x).max()


@pytest.mark.parametrize("model", ["full", "chain"])
def test_constant_disturbance_of_a_double_integrator_leaves_no_error(model):
    case = disturb(Case(INTEGRATORS, TE, 30, ticks=1200, h=0.01), lambda k: -0.4)
    got = trace(case, {"eso": {"model": model}, "pccebo": {}})
    error = {name: np.abs(got.x - xhat)[-50:].max() for name, xhat in got.estimates.items()}
    assert error["eso"] < 1e-8 < 0.01 < error["pccebo"]


def test_chain_neglects_the_model_and_full_does_not():
    damped = linear.Model(np.array([[0.0, 1.0], [-2.0, -0.5]]), INTEGRATORS.B, INTEGRATORS.C)
    start = [1.0, -2.0]
    case = Case(damped, 10, 15, ticks=400, h=0.01, x0=start, xhat0=start)
    error = {
        model: np.abs(got.x - got.estimates["eso"]).max()
        for model in ("full", "chain")
        for got in [trace(case, {"eso": {"model": model}})]
    }
    assert error["full"] < 1e-12
    assert 1e-3 < error["chain"] < 1


@pytest.mark.ci
def test_chain_equals_a_reference_that_is_started_with_the_neglected_acceleration():
    damped = linear.Model(np.array([[0.0, 1.0], [-2.0, -0.5]]), INTEGRATORS.B, INTEGRATORS.C)
    case = Case(damped, 10, 15, ticks=300, h=0.01, noise_std=0.3, xhat0=[0.5, -1.0])
    u, (x0, xhat0) = inputs(case), starts(case)
    x, samples = simulate(Model(damped.A, damped.B, damped.C, case.h), u, x0, [10], [15], noise(case))
    L = design_eso(case, model="chain", omega=4.0).gains.L
    np.testing.assert_allclose(L[:, 0] * [1, 1, 2], reference.eso_gain(4.0, 0.1), rtol=1e-10)
    chain = reference.with_disturbance(Model(INTEGRATORS.A, INTEGRATORS.B, INTEGRATORS.C, case.h))
    z = reference.pccebo(chain, u, samples, np.append(xhat0, damped.A[1] @ xhat0 / 2), L)
    got = trace(case, {"eso": {"model": "chain", "omega": 4.0}})
    np.testing.assert_allclose(got.estimates["eso"], z[:, :2], rtol=0, atol=1e-10 * np.abs(x).max())


def test_unknown_input_is_a_signal():
    model = INTEGRATORS._replace(E=np.array([[0.0], [0.5]]))
    case = Case(model, TE, 10, ticks=40, h=0.01)
    design = design_eso(case)
    assert design.predicts_unknown_input is True
    assert design_eso(case._replace(model=INTEGRATORS)).predicts_unknown_input is None
    observer, gains = OBSERVERS["eso"].observer, design.gains
    np.testing.assert_array_equal(
        observer.estimate(gains, observer.init(gains, jnp.array([1.0, 2.0]))), [1.0, 2.0, 0.0]
    )


def test_certificate_is_that_of_the_placed_poles():
    case = Case(CART, 200, 200, noise_std=0.5)
    certificate = design_eso(case, omega=5.0).certificate
    assert 0 < certificate.margin < 1
    assert np.isfinite(certificate.numbers["noise_rms"]).all()


def test_plant_with_two_outputs_is_refused():
    with pytest.raises(UserError, match="eso in case: got 2 outputs, expected a chain of n integrators"):
        design_eso(Case(ODD, TE, 0))


@pytest.mark.parametrize(("option", "value"), [("pole", 1.0), ("pole", -0.1), ("omega", 0.0)])
def test_option_out_of_range_is_refused(option, value):
    with pytest.raises(ValueError, match=option):
        OBSERVERS["eso"].options(**{option: value})
