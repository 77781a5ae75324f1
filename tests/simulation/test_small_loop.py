"""A closed loop small enough to be written out: command, line, plant and sums, tick by tick in the order of events.

Two states, two inputs on their way for 2.3 ticks, an observer that corrects the present by whatever arrives. The oracle is a
loop in NumPy; of the three runs one leaves its bound and stands still from there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.engine import event_loop
from pcbench.protocols import Controller, Observer, Plant
from pcbench.runtime import config
from pcbench.simulation import command_network, metrics, rng
from pcbench.simulation.schedule import common_times
from pcbench.simulation.types import GridPointParams, Layout

DT, N, TAIL, EVERY, LATE, BACK = 0.1, 60, 25, 4, 3, 16
AGE = 2.3  # ticks that a command is on its way
A, B = np.array([[0.98, 0.11], [-0.15, 0.9]]), np.array([[0.02, 0.1], [0.2, -0.05]])
C, L = np.array([[1.0, 0.3]]), np.array([[0.3], [0.1]])
X0, XHAT0, SPREAD = np.array([1.0, -0.5]), np.array([0.2, 0.1]), np.array([[0.8, 0.0], [0.3, 0.6]])
K = np.array([[0.6, -0.2], [0.1, 0.4]])
NOISE, BAND, BOUND = 0.05, np.array([0.15, 0.1]), np.array([1.9, 1.3])
SEEDS = np.array([3, 8, 9])


class Law(NamedTuple):
    K: np.ndarray
    path: np.ndarray  # [BACK + N + 1, 1] from tick -BACK on


def path(k):
    return 0.5 * np.sin(0.21 * np.asarray(k))[..., None]


def aim(params, tick):
    return params.path[tick + BACK]


CONTROLLER = Controller(
    target=aim,
    before=lambda params, tick, estimate: -params.K @ estimate + 0.1 * aim(params, tick)[0],
    command=lambda params, now, estimate, coming: (
        -params.K @ jnp.append(estimate[:1] - aim(params, now.tick), estimate[1:]) + 0.2 * coming(jnp.asarray(0))
    ),
)
OBSERVER = Observer(
    init=lambda gains, xhat0: xhat0,
    snapshot=lambda gains, memory, now: jnp.zeros(0),
    jump=lambda gains, memory, now, arrival: memory + gains @ jnp.where(arrival.mask, arrival.value - C @ memory, 0.0),
    flow=lambda gains, memory, now: A @ memory + B @ now.u,
    estimate=lambda gains, memory: memory,
)
PLANT = Plant(step=lambda params, now, x: A @ x + B @ now.u, output=lambda params, now, x: C @ x)


def late(t):
    return np.full(np.shape(t), AGE * DT)


@pytest.fixture(scope="module")
def outcome():
    """What the three runs leave, arrays [..., 3]."""
    law = Law(K, path(np.arange(-BACK, N + 1)))
    p = GridPointParams(
        (), {"o": L}, common_times.periodic([EVERY], [LATE], N), np.full((1, 2), np.nan), np.asarray(DT), X0, XHAT0, SPREAD,
        np.array([NOISE]), BAND, BOUND, np.array([[0, TAIL], [TAIL, N - 1], [N - 1, N]]), control=law,
        line=command_network.delay_line(late, DT, BACK, N + 4),
    )  # fmt: skip
    layout = Layout(PLANT, (("o", OBSERVER),), 3, 4, True, controller=CONTROLLER, commands=BACK)
    with config.float64():
        run = jax.jit(lambda p, seeds: event_loop.simulate(layout, p, jnp.asarray(0), seeds))
        return jax.tree.map(np.asarray, run(p, SEEDS))


def input_of(commands, n, newest):
    """The input of tick n: linear interpolation between commands at the middle of the tick less the delay."""
    when = n + 0.5 - AGE
    first = int(np.floor(when))
    a, b = (commands[min(each, newest)] for each in (first, first + 1))
    return a + (when - first) * (b - a)


def reference_run(seed):
    """Errors and set point less state [N, ...] of one run, and when it was lost (-1: never)."""
    with config.float64():
        keys = rng.run_keys(jnp.asarray(0), jnp.asarray([seed]), "initial", 2)
        start = np.asarray(rng.normals(keys, np.zeros(2, int)))[:, 0]
        noise = NOISE * np.asarray(rng.measurement_noise(0, seed, N // EVERY + 1))[0]
    x, xhat, lost = X0 + SPREAD @ start, XHAT0, -1
    commands = {n: -K @ xhat + 0.1 * path(n)[0] for n in range(-BACK, 0)}
    e, off, on_its_way = [], [], {}
    for k in range(N):
        if k % EVERY == 0:
            on_its_way[k + LATE] = C @ x + noise[k // EVERY]
        if k in on_its_way and lost < 0:
            xhat = xhat + L @ (on_its_way[k] - C @ xhat)
        e.append(x - xhat)
        wanted = -K @ (xhat - [path(k)[0], 0.0])
        commands[k] = wanted + 0.2 * input_of(commands, k, k - 1)
        off.append(path(k) - x[:1])
        if lost < 0 and (np.abs(e[-1]) > BOUND).any():
            lost = k
        if lost < 0:
            u = input_of(commands, k, k)
            x, xhat = A @ x + B @ u, A @ xhat + B @ u
    return np.array(e), np.array(off), lost


@pytest.fixture(scope="module")
def runs():
    return [reference_run(seed) for seed in SEEDS.tolist()]


@pytest.mark.parametrize("run", range(3))
def test_sums_of_the_error_and_of_what_is_off_the_set_point_are_those_of_the_ticks(outcome, runs, run):
    e, off, _ = runs[run]
    for found, values in ((outcome.streams["o"], e), (outcome.tracking, off)):
        for window, (a, b) in enumerate([(0, TAIL), (TAIL, N - 1), (N - 1, N)]):
            part = values[a:b]
            for got, want in zip(found, (np.abs(part).sum(0), (part**2).sum(0), np.abs(part).max(0)), strict=True):
                np.testing.assert_allclose(got[window, :, run], want, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(outcome.final["o"][:, run], e[-1], rtol=0, atol=1e-13)


def test_a_run_that_leaves_its_bound_stands_still_and_keeps_its_tick(outcome, runs):
    lost = [when for _, _, when in runs]
    assert sum(when >= 0 for when in lost) == 1
    assert max(lost) > LATE, "a sample has come"
    np.testing.assert_array_equal(outcome.watches["o"].first_bad, lost)


def test_the_metrics_are_those_of_all_ticks_and_of_the_tail(outcome, runs):
    out = metrics.finalize(
        outcome.streams["o"], outcome.watches["o"], outcome.final["o"], N, TAIL, DT, tracking=outcome.tracking
    )
    for run, (e, off, lost) in enumerate(runs):
        for name, values in (
            ("rmse", e),
            ("steady_rmse", e[TAIL:]),
            ("tracking_rmse", off),
            ("steady_tracking_rmse", off[TAIL:]),
        ):
            want = np.full(values.shape[1], np.nan) if lost >= 0 else np.sqrt((values**2).mean(0))
            np.testing.assert_allclose(out[name][:, run], want, rtol=1e-12, err_msg=name)
        last = [np.flatnonzero(outside)[-1] + 1 for outside in (np.abs(e) > BAND).T]
        if lost < 0:
            np.testing.assert_allclose(out["settling_time"][:, run], np.array(last) * DT, rtol=1e-12)
            np.testing.assert_array_equal(out["unsettled"][:, run], np.array(last) > TAIL)
        assert out["divergence_time"][run] == pytest.approx(lost * DT if lost >= 0 else np.nan, nan_ok=True)
