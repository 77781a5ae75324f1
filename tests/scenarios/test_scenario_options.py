"""Choices that the paper leaves open: the rising sawtooth, the lost sign in the drift, a random start."""

import numpy as np
import pytest
from reference import cart

import pcbench
from pcbench.errors import UserError
from pcbench.plants import PLANTS
from pcbench.plants import cart as plant


@pytest.mark.parametrize("observer", ["pccebo", pytest.param("kfbo", marks=pytest.mark.nightly)])
def test_the_rising_sawtooth_equals_the_reference(observer):
    got = pcbench.simulate("cart/nominal", observer, overrides=["options.scenario.input=rising"])
    x, xhat = cart.run("cart/nominal", observer, u=cart.sawtooth(rising=True))
    np.testing.assert_allclose(got["position"], x[:, 0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(got[f"{observer}.position"], xhat[:, 0], rtol=0, atol=1e-10)
    assert got["u1"][0] == -10


@pytest.mark.parametrize("sign", [-1, pytest.param(1, marks=pytest.mark.nightly)])
def test_the_drifts_sign_equals_the_reference(sign):
    got = pcbench.simulate("cart/drift", "kf", overrides=[f"axes.plant.drift_sign={sign}"])
    x, xhat = cart.run("cart/drift", "kf", sign=float(sign), substeps=plant.SUBSTEPS)
    np.testing.assert_allclose(got["position"], x[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(got["kf.position"], xhat[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            "options.scenario.drift_sign=-1",
            r"got drift_sign, .* write axes.plant.drift_sign",
        ),
        ("axes.plant.drift_sign=0.5", r"got 0.5, expected a sign; write 1 or -1"),
    ],
)
def test_the_drifts_sign_is_a_parameter_of_the_cart_and_a_sign(change, what):
    with pytest.raises(UserError, match=what):
        pcbench.simulate("cart/drift", "kf", overrides=[change])


def test_no_other_plant_has_a_sign_that_print_has_lost():
    assert [name for name, plant in PLANTS.items() if "drift_sign" in plant.numbers._asdict()] == ["cart"]


@pytest.mark.nightly
def test_four_runge_kutta_steps_a_tick_are_enough_for_the_drift():
    """Against twenty: below 3e-9 m and 3e-7 m/s at every tick, where one step is 4e-7 m off."""
    u = cart.sawtooth()
    fine = cart.run("cart/drift", "model-only", substeps=20, u=u)[0]
    four = pcbench.simulate("cart/drift", "model-only")[["position", "velocity"]].to_numpy()
    np.testing.assert_array_less(np.abs(four - fine).max(0), [3e-9, 3e-7])


def test_no_drift_is_the_limit_of_a_small_drift():
    """The exact exponential at 0 and the Runge-Kutta map near 0 are one plant."""
    numbers = PLANTS["cart"].numbers
    exact, near = plant.prepare(numbers, 1e-3, 5), plant.prepare(numbers._replace(drift=1e-12), 1e-3, 5)
    np.testing.assert_allclose(near.Phi, np.broadcast_to(exact.Phi, near.Phi.shape), rtol=0, atol=1e-9)
    np.testing.assert_allclose(near.Gamma, np.broadcast_to(exact.Gamma, near.Gamma.shape), rtol=0, atol=1e-8)


@pytest.mark.ci
def test_a_random_initial_state_is_drawn_from_the_prior():
    """The model alone keeps x(0) - xhat(0): position error at the end is p0 + v0 / 122, of variance 25 + (10/122)^2."""
    options = {"scenario": {"random_initial_state": True}}
    runs = pcbench.run("cart/nominal", observers=["model-only"], seeds=4096, options=options).runs
    final = runs[runs.signal == "position"].final_error
    sigma, n = np.sqrt(25 + (10 / 122) ** 2), len(final)
    assert abs(final.mean()) < 4 * sigma / np.sqrt(n)
    assert abs(final.std() / sigma - 1) < 4 / np.sqrt(2 * n)


@pytest.mark.ci
def test_the_same_start_for_every_observer():
    options = {"scenario": {"random_initial_state": True}}
    runs = pcbench.run("cart/nominal", observers=["model-only", "pccebo"], seeds=16, options=options).runs
    peak = runs[runs.signal == "velocity"].pivot(index="seed", columns="observer", values="max_abs_error")
    np.testing.assert_array_equal(peak["model-only"], peak["pccebo"])
    assert peak["pccebo"].nunique() == 16


def test_a_changed_plant_is_not_told_to_the_observers():
    got = pcbench.simulate("cart/nominal", "model-only", overrides=["axes.plant.lam=110.0"])
    x, _ = cart.run("cart/nominal", "model-only")
    np.testing.assert_allclose(got["model-only.velocity"], cart.run("cart/nominal", "model-only")[1][:, 1], atol=1e-10)
    assert np.abs(got["velocity"] - x[:, 1]).max() > 1


def test_a_signal_of_two_columns_on_a_plant_of_one_input_is_refused():
    with pytest.raises(UserError, match=r"2 columns, expected one signal.*1 inputs"):
        pcbench.simulate("arm/sampled", "kf", overrides=["options.scenario.input=heater-1s"])
