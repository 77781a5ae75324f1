"""Gains where outputs repeat each other or show nothing: gains, or one sentence. And gains in other units."""

import jax
import numpy as np
import pytest

import pcbench
from pcbench.errors import UserError
from pcbench.synthesis import current_lmi, error_bounds
from pcbench.synthesis.reduced_order import jacobian

A, B = np.array([[0.0, 1.0], [-2.0, -1.0]]), np.array([[0.0], [1.0]])
OUTPUTS = {"equal": [[1, 0], [1, 0]], "dead": [[1, 0], [0, 0]]}
WAYS = {
    "pccebo": [{"gain": way} for way in ("lmi", "riccati", "decay", "h2", "hinf")],
    "chain": [{"gain": way} for way in ("poles", "riccati", "companion")],
    **{name: [{}] for name in ("pco", "pi-pco", "kfbo", "kf", "equal-delay", "no-delay", "kf-larsen")},
}


def study(observer, options, A, B, C, x=(1.0, 1.0)):
    table = {
        "A": np.array(A).tolist(),
        "B": np.array(B).tolist(),
        "C": np.array(C, float).tolist(),
        "tick": 0.01,
        "sampling_period": 0.1,
        "delay": 0.1,
        "noise_std": 0.01,
        "prior_std": list(x),
        "process_std": [0.01 * size for size in x],
        "duration": 2.0,
    }
    return {"name": "z", "observers": [observer], "options": {observer: options} if options else {}, "lti": table}


@pytest.mark.ci
@pytest.mark.parametrize("outputs", OUTPUTS)
@pytest.mark.parametrize(("observer", "options"), [(o, way) for o, ways in WAYS.items() for way in ways])
def test_outputs_that_repeat_or_show_nothing_leave_gains_or_one_sentence(observer, options, outputs):
    asked = study(observer, options, A, B, OUTPUTS[outputs])
    if observer in ("pco", "pi-pco") or options == {"gain": "companion"}:
        with pytest.raises(UserError, match=r"rank 1, expected [^\n]*$"):
            pcbench.design(asked, observer)
    else:
        gains = [np.ravel(np.asarray(a)) for a in jax.tree.leaves(pcbench.design(asked, observer).gains)]
        assert np.isfinite(np.concatenate(gains)).all()


def test_two_equal_sensors_share_the_gain_of_one():
    Phi, one = np.array([[0.9, 0.1], [-0.2, 0.7]]), np.array([[1.0, 0.0]])
    L = current_lmi.closed_form(Phi, one)
    np.testing.assert_allclose(current_lmi.closed_form(Phi, one[[0, 0]]), L[:, [0, 0]] / 2, rtol=1e-12)


@pytest.mark.ci
@pytest.mark.parametrize("x", [(1e9, 1e9), (1e-9, 1e-9), (1e6, 1e-3), (1e-6, 1e3)])
@pytest.mark.parametrize("way", ["lmi", "riccati"])
def test_a_gain_exists_in_other_units_and_is_the_same(way, x):
    T = np.diag(x)
    plain = pcbench.design(study("pccebo", {"gain": way}, A, B, [[1, 0]]), "pccebo").gains.L
    other = study("pccebo", {"gain": way}, T @ A @ np.linalg.inv(T), T @ B, [[1 / x[0], 0]], x)
    np.testing.assert_allclose(np.linalg.inv(T) @ pcbench.design(other, "pccebo").gains.L, plain, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("x", [(1e6, 1e6), (1e-6, 1e-6), (1e3, 1.0), (1e-6, 1e3)])
@pytest.mark.parametrize("observer", ["pco", "pi-pco"])
def test_gains_of_a_reduced_order_observer_are_the_same_in_other_units(observer, x):
    T = np.diag(x)
    plain = pcbench.design(study(observer, {}, A, B, [[1, 0]]), observer)
    other = pcbench.design(study(observer, {}, T @ A @ np.linalg.inv(T), T @ B, [[1, 0]], x), observer)
    unit = x[1] / x[0]  # of the unmeasured state by that of the output
    solved = 1e-4  # the root of the solver's gap: which bits a processor has decides where it ends within that
    np.testing.assert_allclose(other.gains.Kp / unit, plain.gains.Kp, rtol=solved)
    np.testing.assert_allclose(other.gains.Ki / unit, plain.gains.Ki, rtol=solved, atol=1e-9)
    np.testing.assert_allclose(
        np.asarray(other.certificate.numbers["P"]) * x[1] ** 2, plain.certificate.numbers["P"], rtol=solved
    )


@pytest.mark.parametrize("way", ["pco", "kf", "kfbo"])
def test_a_position_in_another_unit_is_as_good(way):
    gains = jax.tree.leaves(pcbench.design(study(way, {}, A, B, [[1e-7, 0]]), way).gains)
    assert all(np.isfinite(np.asarray(gain)).all() for gain in gains)


@pytest.mark.parametrize(("k", "l"), [(2, 1), (3, 1), (3, 2), (5, 2)])
def test_with_more_unmeasured_states_than_outputs_the_map_has_the_eigenvalue_one(k, l):
    """So pi-pco cannot exist for n > 2 q."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        A12, A22, Kp, Ki = (rng.standard_normal(shape) for shape in ((1, l, k), (1, k, k), (k, l), (k, l)))
        J = jacobian(A12, A22, Kp, Ki)[0]
        assert np.abs(np.linalg.eigvals(J) - 1).min() < 1e-9


def test_pi_pco_says_that_it_cannot_exist():
    chain = np.eye(3, k=1) - np.diag([0.0, 0.0, 1.0])
    with pytest.raises(UserError, match=r"3 states and 1 independent output, expected at most 2 states.* Use pco"):
        pcbench.design(study("pi-pco", {}, chain, [[0], [0], [1]], [[1, 0, 0]], (1, 1, 1)), "pi-pco")


def test_stationary_covariance_equals_a_linear_system_in_any_units():
    F, N = np.array([[0.8, 0.2, 0.0], [-0.1, 0.7, 0.3], [0.05, 0.0, 0.9]]), np.diag([1.0, 2.0, 0.5])
    X = np.linalg.solve(np.eye(9) - np.kron(F, F), N.ravel()).reshape(3, 3)
    np.testing.assert_allclose(error_bounds.covariance(F, N), X, rtol=1e-12)
    units = np.array([1e-30, 1.0, 1e30])
    ratio = np.outer(units, 1 / units)
    scaled = error_bounds.covariance(F * ratio, N * np.outer(units, units))
    np.testing.assert_allclose(scaled, X * np.outer(units, units), rtol=1e-12)
    assert np.isnan(error_bounds.covariance(1.1 * np.eye(2), np.eye(2))).all()
