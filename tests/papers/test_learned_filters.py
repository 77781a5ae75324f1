"""The settings of the claims on learned filters: models, noise and the filters that they are compared with, against NumPy."""

import jax
import numpy as np
import pytest

from pcbench.external.gain_network import draw
from pcbench.papers.field import learned_filters

STEP = 0.02  # [s]


def taylor(terms, x):
    """The sum of (A(x) h)^j / j! x, j to `terms`; x may be complex."""
    A = np.array([[-10.0, 10.0, 0.0], [28.0, -1.0, -x[0]], [0.0, x[0], -8.0 / 3.0]])
    total, power = x, x
    for j in range(1, terms + 1):
        power = STEP * A @ power / j
        total = total + power
    return total


def slope(f, x):
    """The Jacobian of f at x by complex steps."""
    columns = [np.imag(f(x + 1e-30j * e)) / 1e-30 for e in np.eye(len(x))]
    return np.array(columns).T


def extended_filter(f, h, x, P, Q, R, y):
    """Estimates of the extended Kalman filter, R one for each measurement."""
    out = []
    for each, noise in zip(y, R, strict=True):
        C = slope(h, x)
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + noise)
        x, P = x + K @ (each - h(x)), (np.eye(len(x)) - K @ C) @ P
        out.append(x)
        A = slope(f, x)
        x, P = f(x), A @ P @ A.T + Q
    return np.array(out)


@pytest.mark.parametrize("terms", [2, 5])
def test_lorenz_step_is_the_sum_of_its_series(terms):
    for x in np.random.default_rng(0).uniform(-20, 30, (20, 3)):
        np.testing.assert_allclose(learned_filters.lorenz_step(terms, x), taylor(terms, x), rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("terms", [2, 5])
def test_extended_filter_of_the_lorenz_system_equals_numpy(terms):
    system = learned_filters.lorenz(terms)
    _, y = draw(system, jax.random.key(4))
    found = learned_filters.ekf(system, y, 1.3)
    start = taylor(terms, np.ones(3))
    R = np.broadcast_to(np.eye(3), (len(y), 3, 3))
    P, Q = 0.01 * np.eye(3), 1.69 * 0.01 * np.eye(3)
    want = extended_filter(lambda x: taylor(terms, x), lambda x: x, start, P, Q, R, np.asarray(y))
    np.testing.assert_allclose(found, want, rtol=1e-10, atol=1e-10)


def test_bimodal_noise_has_the_variances_that_the_filter_is_given():
    keys = jax.random.split(jax.random.key(0), 400)
    draws = np.asarray(jax.vmap(lambda key: learned_filters.bimodal(key, 50)[:, 0])(keys)).ravel()
    std = np.asarray(jax.vmap(lambda key: learned_filters.standard_deviations(key, 50)[:, 0])(keys)).ravel()
    wide = std == learned_filters.WIDE
    assert abs(wide.mean() - 0.6) < 4 * np.sqrt(0.24 / len(std))
    for which, variance in ((wide, 1.25**2), (~wide, 0.39528**2)):
        assert draws[which].var() == pytest.approx(variance, rel=4 * np.sqrt(2 / which.sum()))
    assert draws.var() == pytest.approx(1.0, rel=0.05)


def test_filter_that_is_given_each_variance_equals_numpy():
    system, key = learned_filters.constant_velocity(), jax.random.key(7)
    _, y = draw(system, key)
    std = np.asarray(learned_filters.standard_deviations(key, system.ticks))[:, 0]
    R, Q = std[:, None, None] ** 2, system.process @ system.process.T
    F, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    found = learned_filters.kalman(system, R, Q, y)
    P = system.spread @ system.spread.T
    want = extended_filter(lambda x: F @ x, lambda x: C @ x, F @ [0.0, 1.0], P, Q, R, np.asarray(y))
    np.testing.assert_allclose(found, want, rtol=1e-10, atol=1e-10)
