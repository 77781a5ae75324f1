"""A closed loop small enough to be written out as one linear recursion, whose covariance NumPy propagates by itself.

Two states and two inputs that come two ticks late, a random start, noise of samples that are three ticks late and of the
process: everything that is random at once. A command that saturates, or an observer with a sign, must be found out.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from reference.propagation import Moments

from pcbench.moments.programs import compute
from pcbench.moments.realisations import Realisation
from pcbench.protocols import Controller, Observer, Plant
from pcbench.runtime import config
from pcbench.simulation import command_network, metrics
from pcbench.simulation.schedule import common_times
from pcbench.simulation.types import GridPointParams, Layout

pytestmark = pytest.mark.usefixtures("in_a_hurry")

DT, N, TAIL, EVERY, LATE, BACK, AWAY = 0.1, 90, 35, 4, 3, 16, 2
A, B = np.array([[0.98, 0.11], [-0.15, 0.9]]), np.array([[0.02, 0.1], [0.2, -0.05]])
C, L = np.array([[1.0, 0.3]]), np.array([[0.3], [0.1]])
X0, XHAT0, SPREAD = np.array([1.0, -0.5]), np.array([0.2, 0.1]), np.array([[0.8, 0.0], [0.3, 0.6]])
K, Q1, Q2 = np.array([[0.6, -0.2], [0.1, 0.4]]), np.array([[2.0, 0.3], [0.3, 0.5]]), np.array([[0.4, 0.0], [0.1, 0.2]])
X_REF, U_REF = np.random.default_rng(1).normal(size=(2, N + 1, 2))
NOISE, PROCESS = 0.05, np.array([0.02, 0.05])


class Law(NamedTuple):
    K: np.ndarray
    limit: np.ndarray


def path(k):
    return 0.5 * jnp.sin(0.21 * k)[None]


def command(params, now, estimate, coming):
    free = -params.K @ jnp.append(estimate[:1] - path(now.tick), estimate[1:])
    return jnp.clip(free, -params.limit, params.limit)


CONTROLLER = Controller(lambda params, tick: path(tick), lambda params, tick, estimate: -params.K @ estimate, command)
OBSERVER = Observer(
    init=lambda gains, xhat0: xhat0,
    snapshot=lambda gains, memory, now: jnp.zeros(0),
    jump=lambda gains, memory, now, arrival: memory + gains @ jnp.where(arrival.mask, arrival.value - C @ memory, 0.0),
    flow=lambda gains, memory, now: A @ memory + B @ now.u,
    estimate=lambda gains, memory: memory,
)
PLANT = Plant(step=lambda params, now, x: A @ x + B @ now.u, output=lambda params, now, x: C @ x)


def moment_sums(limit=np.inf, observer=OBSERVER, noise=NOISE):
    p = GridPointParams(
        (), {"o": L}, common_times.periodic([EVERY], [LATE], N), np.full((1, 2), np.nan), np.asarray(DT), X0, XHAT0, SPREAD,
        np.array([noise]), np.ones(2), np.full(2, 1e6), np.array([[0, TAIL], [TAIL, N - 1], [N - 1, N]]),
        process_std=PROCESS, control=Law(K, np.asarray(limit)), line=command_network.constant_delay_line(AWAY, BACK, N + 4),
        weights=metrics.Weights(Q1, Q2, X_REF, U_REF),
    )  # fmt: skip
    layout = Layout(PLANT, (("o", observer),), 1, 4, True, watch=False, controller=CONTROLLER, commands=BACK)
    with config.float64():
        return compute([Realisation(layout, p, ())], "").sums


@pytest.fixture(scope="module")
def found(in_a_hurry):
    return moment_sums()


def propagate():
    """Sums over horizon and tail of E e^2, E (target - x)^2, the cost and E u^2."""
    x, xhat, last, before, packet = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 8), slice(8, 9)
    eye = np.eye(9)
    z = Moments(np.zeros(9), np.zeros((9, 9)))
    z.mean[x], z.mean[xhat] = X0, XHAT0
    z.mean[last] = z.mean[before] = -K @ XHAT0
    z.covariance[x, x] = SPREAD @ SPREAD.T
    error, out = eye[x] - eye[xhat], {name: [] for name in ("e", "off", "cost", "u")}
    for k in range(N):
        if k % EVERY == 0:  # a sample is taken
            F, G = eye.copy(), np.zeros((9, 1))
            F[packet], F[packet, x], G[packet] = 0.0, C, NOISE
            z.move(F, G=G)
        if k >= LATE and (k - LATE) % EVERY == 0:  # and arrives
            F = eye.copy()
            F[xhat, xhat], F[xhat, packet] = np.eye(2) - L @ C, L
            z.move(F)
        target = 0.5 * np.sin(0.21 * k)
        out["e"].append(z.square(error))
        out["off"].append(z.square(-eye[:1], target))
        second = z.covariance + np.outer(z.mean, z.mean)
        off, more = z.mean[x] - X_REF[k], z.mean[before] - U_REF[k]
        spread = np.trace(Q1 @ z.covariance[x, x]) + np.trace(Q2 @ z.covariance[before, before])
        out["cost"].append(spread + off @ Q1 @ off + more @ Q2 @ more)
        out["u"].append(np.trace(second[before, before]))
        F, f, G = np.zeros((9, 9)), np.zeros(9), np.zeros((9, 2))
        F[x, x], F[x, before], G[x] = A, B, np.diag(PROCESS)
        F[xhat, xhat], F[xhat, before] = A, B
        F[last, xhat], F[before, last], F[packet, packet] = -K, np.eye(2), 1.0
        f[last] = K[:, 0] * target
        z.move(F, f, G)
    whole = {name: np.array(each) for name, each in out.items()}
    return {name: np.stack([each.sum(0), each[TAIL:].sum(0)]) for name, each in whole.items()}


@pytest.mark.ci
def test_a_loop_with_everything_random_is_the_covariance_recursion(found):
    """1e-10: two ways of adding up 90 ticks in double precision."""
    expected = propagate()
    np.testing.assert_allclose(found.square[..., 0], expected["e"], rtol=1e-10)
    np.testing.assert_allclose(found.tracking[..., 0], expected["off"], rtol=1e-10)
    np.testing.assert_allclose(found.cost[..., 0], expected["cost"], rtol=1e-10)
    np.testing.assert_allclose(found.input[..., 0], expected["u"], rtol=1e-10)


@pytest.mark.ci
def test_runs_with_noise_are_where_the_directions_say(found):
    assert (found.deviation / found.size).max() < 1e-12


@pytest.mark.ci
def test_a_command_that_saturates_is_found_out():
    """At eight times the noise it does, at the noise's own size it does not."""
    s = moment_sums(limit=2.0)
    assert (s.deviation / s.size).min() > 1e-3
