"""The coordinated turn: its step by an adaptive integrator, and a run with its extended and cubature filters by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
from reference import threefry
from scipy.integrate import solve_ivp

import pcbench
from pcbench.papers import field
from pcbench.plants import coordinated_turn
from pcbench.protocols import Now
from pcbench.runtime import config

SEED, STEPS = 5, 40
SIGNALS = [name for name, _ in coordinated_turn.SIGNALS]
Q1, Q2 = 0.1, 1.75e-4
M = np.array([[1 / 3, 1 / 2], [1 / 2, 1]])
Q = np.zeros((5, 5))
Q[:2, :2] = Q[2:4, 2:4] = Q1 * M
Q[4, 4] = Q2
R = np.diag([100.0, 1e-5])
P0 = np.diag([100.0, 10.0, 100.0, 10.0, 1e-4])
STARTS = {"printed": (1000.0, 300.0, 1000.0, 0.0, np.radians(-3.0)), "behind": (-6000.0, 50.0, 400.0, -60.0, 0.002)}


def move(x):
    w = x[4]
    s, c = np.sin(w) / w, 2 * np.sin(w / 2) ** 2 / w  # 1 - cos(w) loses digits where w is small
    return np.array(
        [
            x[0] + s * x[1] - c * x[3],
            np.cos(w) * x[1] - np.sin(w) * x[3],
            x[2] + c * x[1] + s * x[3],
            np.sin(w) * x[1] + np.cos(w) * x[3],
            w,
        ]
    )


def output(x):
    return np.array([np.hypot(x[0], x[2]), np.arctan2(x[2], x[0])])


def slopes(f, x):
    size = 1e-6 * np.maximum(np.abs(x), 1e-2)
    return np.array([(f(x + d) - f(x - d)) / (2 * d.sum()) for d in np.diag(size)]).T


def turn_slope(x):
    """d moved / dx by complex steps."""
    return np.array([move(x + 1e-30j * e).imag / 1e-30 for e in np.eye(5)]).T


def sight_slope(x):
    r = np.hypot(x[0], x[2])
    return np.array([[x[0] / r, 0, x[2] / r, 0, 0], [-x[2] / r**2, 0, x[0] / r**2, 0, 0]])


def wrap(y):
    return np.array([y[0], np.angle(np.exp(1j * y[1]))])


def run(x, noise):
    """The states of all steps and the measurements from step 1 on, with the draws of the run."""
    path = [np.array(x)]
    for k in range(STEPS):
        w = np.array([threefry.normal(0, SEED, "process", j, k) for j in range(5)])
        path.append(move(path[-1]) + noise @ w)
    v = [[threefry.normal(0, SEED, "measurement", j, i) for j in range(2)] for i in range(STEPS)]
    return np.array(path), [output(x) + np.sqrt(np.diag(R)) * e for x, e in zip(path[1:], np.array(v), strict=True)]


def extended_filter(z, P, ys):
    out = [z]
    for y in ys:
        F = turn_slope(z)
        z, P = move(z), F @ P @ F.T + Q
        H = sight_slope(z)
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        z, P = z + K @ wrap(y - output(z)), P - K @ H @ P
        out.append(z)
    return np.array(out)


def cubature(z, P, ys):
    def points(z, P):
        L = np.sqrt(5) * np.linalg.cholesky(P)
        return np.concatenate([z + L.T, z - L.T])

    out = [z]
    for y in ys:
        X = np.array([move(point) for point in points(z, P)])
        z = X.mean(0)
        P = (X - z).T @ (X - z) / 10 + Q
        X = points(z, P)
        at = output(z)
        Y = np.array([wrap(output(each) - at) for each in X])  # from what is seen of the centre
        mean = Y.mean(0)
        S, across = (Y - mean).T @ (Y - mean) / 10 + R, (X - z).T @ (Y - mean) / 10
        z = z + across @ np.linalg.solve(S, wrap(y - at - mean))
        P = P - across @ np.linalg.solve(S, across.T)
        out.append(z)
    return np.array(out)


def test_linear_model_is_the_slope_at_the_start():
    model, x = coordinated_turn.nominal(coordinated_turn.Numbers()), np.array(coordinated_turn.START)
    np.testing.assert_allclose(model.A, turn_slope(x), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(model.C, slopes(output, x), rtol=0, atol=1e-7)
    assert not model.B.any()


@pytest.mark.parametrize("rate", [-0.7, -0.05, -2e-4, -1e-4, -1e-9, 0.0, 5e-5, 9.9e-5, 1.01e-4, 0.3])
def test_a_step_is_the_motion_of_a_second_at_any_rate_of_turn(rate):
    def turning(t, x):
        return [x[1], -rate * x[3], x[3], rate * x[1]]

    start = [1000.0, 300.0, -500.0, 80.0]
    want = solve_ivp(turning, (0, 1), start, method="DOP853", rtol=3e-14, atol=1e-11).y[:, -1]
    with config.float64():
        numbers = coordinated_turn.prepare(coordinated_turn.Numbers(), 1.0, 1)
        now = Now(*map(jnp.asarray, (0.0, 0, 1.0)), jnp.zeros(1), lambda age: jnp.zeros(1))
        got = coordinated_turn.successor(numbers, now, jnp.array([*start, rate]), jnp.zeros(0))
    np.testing.assert_allclose(got, [*want, rate], rtol=1e-13, atol=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize("start", STARTS)
def test_run_and_its_filters_are_the_references(start):
    """From the printed start, and across the line behind the radar, where the bearing jumps by 2 pi."""
    x = np.array(STARTS[start])
    z = x + np.array([5.0, 2.0, -8.0, 1.0, 0.004])
    given = {"x0": x.tolist(), "xhat0": z.tolist(), "duration": STEPS + 1.0}
    frame = pcbench.simulate(
        {"name": "turn", "scenario": {"base": "coordinated-turn/radar"} | given}, ["ekf", "ukf"], seed=SEED
    ).iloc[: STEPS + 1]
    path, ys = run(x, np.linalg.cholesky(Q))
    jumps = np.abs(np.diff([y[1] for y in ys])).max() > 6
    assert jumps == (start == "behind")
    for prefix, want in (("", path), ("ekf.", extended_filter(z, P0, ys)), ("ukf.", cubature(z, P0, ys))):
        for j, name in enumerate(SIGNALS):
            got, theirs = frame[prefix + name].to_numpy(), want[:, j]
            np.testing.assert_allclose(got, theirs, rtol=0, atol=1e-10 * np.abs(theirs).max(), err_msg=prefix + name)


def test_another_tick_is_refused():
    with pytest.raises(pcbench.UserError, match=r"got a tick of 0.5 s where step moves by 1 s"):
        pcbench.simulate({"name": "half", "scenario": {"base": "coordinated-turn/radar", "dt": 0.5}}, ["ekf"])


@pytest.mark.slow
def test_errors_are_those_of_an_independent_program():
    assert [row.claim for row in field.coordinated_turn.rows() if row.verdict != "reproduced"] == []
