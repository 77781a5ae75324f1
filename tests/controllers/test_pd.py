"""The PD law by itself: its signs, its limits, and a prediction that ends at the very time the command acts."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pcbench.controllers import pd
from pcbench.protocols import Now
from pcbench.runtime import config
from pcbench.scenarios.signals import PATHS

DT, ROWS, TICKS = 0.01, 20, 400
GIVEN = {"Kp": (3.0, 1.5), "Kd": (0.7, 0.4), "limit": (4.0, 1.2), "path": "circle"}
VISCOUS = np.array([0.6, 0.9])


def delay(t):
    return 0.043 + 0.02 * np.sin(2.0 * t)


def model(now, x, B):
    """Two masses with friction, coupled by a spring that hardens."""
    pull = jnp.array([1.0, -1.0]) * (x[0] - x[1]) ** 3
    return jnp.concatenate([x[2:], now.u - B * x[2:] - pull])


def inverse(B, position, rate, acceleration):
    return acceleration + B * rate + position


def params_of(**changes):
    options = pd.Options(**GIVEN | changes)
    return options, pd.prepare(options, delay, DT, ROWS, TICKS, model, inverse)


def unasked(i):
    raise AssertionError("the law asks for an input that is to come")


def command(options, params, k, estimate, coming=unasked):
    now = Now(jnp.asarray(k * DT), jnp.asarray(k), jnp.asarray(DT), jnp.zeros(2), lambda age: age)
    with config.float64():
        return np.asarray(pd.controller(options).command(params, now, jnp.asarray(estimate), coming))


def aim(t):
    return PATHS["circle"](np.array([t]))[0]


STATE = np.array([1.2, 0.7, 0.3, -0.4])


def clip(u):
    return np.clip(u, -np.array(GIVEN["limit"]), GIVEN["limit"])


@pytest.mark.parametrize("k", [0, 7, 150])
def test_it_pulls_towards_the_path_of_now_and_damps_the_rate_within_its_limits(k):
    options, params = params_of()
    target, rate, _ = aim(k * DT)
    for size in (1.0, 30.0):
        x = np.concatenate([target, rate]) + size * (STATE - 1)
        want = -np.array(GIVEN["Kp"]) * (x[:2] - target) - np.array(GIVEN["Kd"]) * (x[2:] - rate)
        np.testing.assert_allclose(command(options, params, k, [*x, *VISCOUS]), clip(want), rtol=1e-12)
    np.testing.assert_array_equal(pd.controller(options).target(params, jnp.asarray(k)), target)


def test_a_command_acts_when_its_delay_is_over():
    t = np.arange(0, 3, 0.01)
    sigma = pd.acts_at(t, delay)
    np.testing.assert_allclose(sigma - delay(sigma), t, rtol=0, atol=1e-14)


@pytest.mark.parametrize("k", [3, 90, 201])
def test_the_prediction_ends_when_the_command_acts_and_not_at_a_whole_tick(k):
    """Against an adaptive solver under the inputs to come, held over whole ticks; the last piece is a part of one."""
    options, params = params_of(predictor=True)
    coming = lambda i: jnp.array([0.8, -0.5]) * (1 + i)  # noqa: E731
    (sigma,) = pd.acts_at(np.array([k * DT]), delay)
    x, at = STATE.copy(), 0
    while k * DT + at * DT < sigma - 1e-12:
        length = min(DT, sigma - (k + at) * DT)
        u = np.array([0.8, -0.5]) * (1 + at)

        def rate(t, x, u=u):
            pull = np.array([1.0, -1.0]) * (x[0] - x[1]) ** 3
            return np.concatenate([x[2:], u - VISCOUS * x[2:] - pull])

        x, at = solve_ivp(rate, (0, length), x, rtol=1e-11, atol=1e-12).y[:, -1], at + 1
    assert sigma / DT % 1 > 0.05, "the last piece is a part of a tick"
    target, rates, _ = aim(sigma)
    want = clip(-np.array(GIVEN["Kp"]) * (x[:2] - target) - np.array(GIVEN["Kd"]) * (x[2:] - rates))
    got = command(options, params, k, [*STATE, *VISCOUS], coming)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-8)
    assert np.abs(want - command(*params_of(), k, [*STATE, *VISCOUS])).max() > 0.01, "it is another than without"


def test_feedforward_is_the_input_of_the_path_at_the_time_the_command_acts():
    options, params = params_of(feedforward=True, limit=(100.0, 100.0))
    plain = command(*params_of(limit=(100.0, 100.0)), 42, [*STATE, *VISCOUS])
    (sigma,) = pd.acts_at(np.array([0.42]), delay)
    got = command(options, params, 42, [*STATE, *VISCOUS])
    np.testing.assert_allclose(got - plain, inverse(VISCOUS, *aim(sigma)), rtol=1e-12)


@pytest.mark.parametrize("predicts", [False, True])
def test_before_0_the_law_is_that_of_the_estimate_of_0_on_the_path_of_its_own_time(predicts):
    options, params = params_of(predictor=predicts)
    for tick in (-ROWS, -1):
        when = pd.acts_at(np.array([tick * DT]), delay)[0] if predicts else tick * DT
        target, rate, _ = aim(when)
        want = clip(-np.array(GIVEN["Kp"]) * (STATE[:2] - target) - np.array(GIVEN["Kd"]) * (STATE[2:] - rate))
        got = pd.controller(options).before(params, jnp.asarray(tick), jnp.asarray([*STATE, *VISCOUS]))
        np.testing.assert_allclose(got, want, rtol=1e-12)
