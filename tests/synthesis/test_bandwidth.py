"""Gains by bandwidth: the poles of the error, and what is refused."""

import numpy as np
import pytest
from harness import ODD
from reference.field_observers import eso_gain
from scipy.linalg import expm

from pcbench.dynamics.linear import Model
from pcbench.errors import DesignError, UserError
from pcbench.synthesis import bandwidth


def double_integrator(T):
    """Return Phi and C of a double integrator with a constant disturbance."""
    return np.array([[1.0, T, T * T / 2], [0.0, 1.0, T], [0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])


def test_gain_of_a_double_integrator_has_the_printed_digits():
    beta = np.exp(-20 * 0.01)
    assert round(float(beta), 5) == 0.81873
    L = bandwidth.current_gain(*double_integrator(0.01), beta, beta, "here")[:, 0]
    np.testing.assert_array_equal(np.round(L, 6), [0.451188, 8.964126, 59.562428])


@pytest.mark.parametrize(("omega", "T"), [(20.0, 0.01), (3.0, 0.2), (0.5, 1.0)])
def test_gain_equals_the_closed_form_and_has_all_poles_at_beta(omega, T):
    Phi, C = double_integrator(T)
    beta = np.exp(-omega * T)
    L = bandwidth.current_gain(Phi, C, beta, beta, "here")
    np.testing.assert_allclose(L[:, 0], eso_gain(omega, T), rtol=1e-10)
    wanted = np.poly([beta] * 3)  # coefficients, as a threefold eigenvalue itself is known to 1e-5 only
    np.testing.assert_allclose(np.poly(Phi @ (np.eye(3) - L @ C)), wanted, rtol=1e-10, atol=1e-10)


def test_deadbeat_gain_is_that_of_the_unknown_input_observer():
    T = 0.01
    Phi, C = double_integrator(T)
    L = bandwidth.current_gain(Phi, C, 0.0, 0.0, "here")
    np.testing.assert_allclose(L[:, 0], [1.0, 3 / (2 * T), 1 / T**2], rtol=1e-10)
    scale = np.diag([1.0, T, T * T])  # units in which the entries of Phi are of size 1
    F = scale @ (np.eye(3) - L @ C) @ Phi @ np.linalg.inv(scale)
    assert np.abs(np.linalg.matrix_power(F, 3)).max() < 1e-12
    assert np.abs(np.linalg.matrix_power(F, 2)).max() > 0.1


def test_modes_faster_than_the_limit_keep_their_poles():
    Phi, C = expm(np.array([[0.0, 1.0], [0.0, -122.0]]) * 0.2), np.array([[1.0, 0.0]])
    L = bandwidth.current_gain(Phi, C, 0.5, 0.5, "here")
    poles = np.sort(np.linalg.eigvals((np.eye(2) - L @ C) @ Phi))
    np.testing.assert_allclose(poles, [np.exp(-24.4), 0.5], rtol=1e-9, atol=1e-14)
    assert np.abs(L).max() < 1


def test_poles_of_several_outputs_are_placed():
    Phi = expm(ODD.A * 0.3)
    L = bandwidth.current_gain(Phi, ODD.C, 0.5, 0.01, "here")
    np.testing.assert_allclose(
        np.sort(np.linalg.eigvals((np.eye(3) - L @ ODD.C) @ Phi)), 0.5 * np.array([13, 14, 15]) / 15
    )


def test_chain_coordinates_are_the_derivatives_of_the_output():
    A, G = np.array([[0.0, 2.0], [-3.0, -0.5]]), np.array([[0.0], [4.0]])
    chain = bandwidth.chain_of(Model(A, np.array([[1.0], [4.0]]), np.array([[1.0, 0.0]]), E=G), "here")
    np.testing.assert_array_equal(chain.O, [[1.0, 0.0], [0.0, 2.0]])
    np.testing.assert_array_equal(chain.row, [[-6.0, -1.0]])
    assert chain.b == 8.0


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({"discrete": True}, "a discrete plant"),
        ({"C": np.eye(2)}, "2 outputs"),
        ({"B": np.eye(2)}, "2 disturbed inputs"),
        ({"D": np.ones((1, 1))}, "feedthrough"),
        ({"B": np.array([[1.0], [0.0]])}, "a disturbance of relative degree 1 with 2 states"),
        ({"B": np.zeros((2, 1))}, "a disturbance of relative degree None with 2 states"),
    ],
)
def test_plant_that_is_no_chain_is_refused(changed, found):
    model = Model(np.array([[0.0, 1.0], [-2.0, -1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]))
    assert bandwidth.chain_of(model, "here").b == 1.0
    with pytest.raises(UserError, match=f"here: got {found}, expected a chain of n integrators"):
        bandwidth.chain_of(model._replace(**changed), "here")


def test_longer_chain_than_supported_is_refused():
    model = Model(np.eye(3, k=1), np.eye(3)[:, 2:], np.eye(3)[:1])
    assert bandwidth.chain_of(model, "here").b == 1.0
    with pytest.raises(UserError, match="got 3 states, expected a chain of 2 integrators"):
        bandwidth.chain_of(model, "here", 2)


def test_slow_mode_that_no_output_shows_is_reported():
    with pytest.raises(DesignError, match="here: the poles were not placed"):
        bandwidth.current_gain(np.diag([0.9, 1.0]), np.array([[1.0, 0.0]]), 0.5, 0.5, "here")
