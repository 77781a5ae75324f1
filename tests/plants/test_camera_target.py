"""The platform with a camera: its motion, and both filters in their loops against estimates that share no code with pcbench."""

import jax.numpy as jnp
import numpy as np
import pytest
from reference import threefry
from scipy.integrate import solve_ivp

import pcbench
from pcbench.plants import camera_target
from pcbench.protocols import Now
from pcbench.scenarios import SCENARIOS

RATE, ZETA, H = 2 * np.pi * 0.25, 0.1, 0.05
LATE, SLOW = 4, 4  # ticks of the camera
W_STD, V_STD = np.array([0.001, 0.0, 0.08]), np.array([0.005, 0.0005])
X0, PRIOR = np.array([0.3, 0.3, 0.3]), np.array([0.3, 0.3, 0.5])
SIGNALS = [name for name, _ in camera_target.SIGNALS]


def motion(x, u):
    """The derivative of offset, target and its velocity."""
    return np.array([x[2] - u, x[2], -(RATE**2) * x[1] - 2 * ZETA * RATE * x[2]])


def after_tick(x, u):
    return solve_ivp(lambda t, x: motion(x, u), (0, H), x, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


PHI = np.stack([after_tick(e, 0.0) for e in np.eye(3)], 1)
GAMMA = after_tick(np.zeros(3), 1.0)
H_CAMERA, H_ENCODER = np.array([1.0, 0, 0]), np.array([-1.0, 1, 0])


def test_tick_and_outputs_equal_an_integration():
    params = camera_target.prepare(camera_target.Numbers(), H, 10)
    x, u = jnp.array([0.4, -0.7, 1.1]), 0.9
    now = Now(jnp.asarray(0.0), jnp.asarray(0), jnp.asarray(H), jnp.array([u]), lambda age: jnp.array([u]))
    np.testing.assert_allclose(camera_target.PLANT.step(params, now, x), after_tick(x, u), rtol=0, atol=1e-12)
    np.testing.assert_allclose(camera_target.PLANT.output(params, now, x), [0.4, -0.7 - 0.4], rtol=0, atol=1e-15)


def least_squares(k, u, arrived):
    """The most likely x(k) of all noise before it, from one large least-squares problem of whitened unknowns."""
    maps, offset = [np.hstack([np.diag(PRIOR), np.zeros((3, 3 * k))])], [np.zeros(3)]
    for i in range(k):
        moved = PHI @ maps[i]
        moved[:, 3 + 3 * i : 6 + 3 * i] += np.diag(W_STD)
        maps.append(moved)
        offset.append(PHI @ offset[i] + GAMMA * u[i])
    rows, y = [np.eye(3 + 3 * k)], [np.zeros(3 + 3 * k)]
    for taken, row, std, value in arrived:
        rows.append((row @ maps[taken] / std)[None])
        y.append(np.array([(value - row @ offset[taken]) / std]))
    z = np.linalg.lstsq(np.vstack(rows), np.concatenate(y), rcond=None)[0]
    return maps[k] @ z + offset[k]


def ignoring(xhat, P, due):
    """A Kalman update by what arrives, as if it were of now, in one piece."""
    C, R = np.stack([row for _, row, _, _ in due]), np.diag([std**2 for _, _, std, _ in due])
    L = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    return xhat + L @ (np.array([value for *_, value in due]) - C @ xhat), (np.eye(3) - L @ C) @ P


def loop(K, ticks, seed, knows, late=LATE, flip=1.0):
    """x, xhat and u of a closed loop; `late` and `flip` are wrong on purpose in one test."""
    x, xhat, P, u, arrived, table = X0, np.zeros(3), np.diag(PRIOR**2), [], [], []
    sent = []
    for k in range(ticks):
        for c, row in ((0, H_CAMERA), (1, H_ENCODER)):
            if c == 1 or k % SLOW == 0:
                v = threefry.normal(0, seed, "measurement", c, k // (1, SLOW)[1 - c])
                sent.append((k + (late if c == 0 else 0), (k, row, V_STD[c], row @ x + V_STD[c] * v)))
        due = [sample for when, sample in sent if when == k]
        arrived += due
        if knows:
            xhat = least_squares(k, u, arrived)
        else:
            xhat, P = ignoring(xhat, P, due)
        u.append(-flip * float(K @ xhat))
        table.append((x, xhat))
        w = np.array([threefry.normal(0, seed, "process", c, k) for c in range(3)])
        x = PHI @ x + GAMMA * u[k] + W_STD * w
        xhat, P = PHI @ xhat + GAMMA * u[k], PHI @ P @ PHI.T + np.diag(W_STD**2)
    return [np.array(each) for each in zip(*table, strict=True)]


def simulate(scenario, observer, seed):
    frame = pcbench.simulate(scenario, observer, seed=seed)
    return frame[SIGNALS].to_numpy(), frame[[f"{observer}.{name}" for name in SIGNALS]].to_numpy()


CASES = [
    ("camera-target/following", "kf", [-8.0, 0, -1]),
    ("camera-target/servoing", "kf-ignore-delay", [-4.0, 0, 0]),
]


@pytest.mark.ci
@pytest.mark.parametrize(("scenario", "observer", "K"), CASES)
def test_loop_and_its_filter_are_the_references(scenario, observer, K):
    ticks, seed = 50, 3
    got = simulate(scenario, observer, seed)
    want = loop(np.array(K), ticks, seed, observer == "kf")
    for mine, theirs in zip(got, want, strict=True):
        np.testing.assert_allclose(mine[:ticks], theirs, rtol=0, atol=1e-10 * np.abs(theirs).max())
    for wrong in ({"late": LATE + 1}, {"flip": -1.0}):  # one tick later, or the other sign
        _, other = loop(np.array(K), ticks, seed, observer == "kf", **wrong)
        assert np.abs(other - want[1]).max() > 1e-3


@pytest.mark.ci
def test_perfect_start_of_the_loop():
    table = {"base": "camera-target/following", "process_std": [0.0] * 3, "noise_std": [0.0, 0.0],
             "assumed_noise_std": [0.005, 0.0005], "xhat0": list(X0), "assumed_process_std": list(W_STD)}  # fmt: skip
    x, xhat = simulate({"name": "perfect", "scenario": table}, "kf", 0)
    assert np.abs(x - xhat).max() < 1e-13
    assert np.abs(x[-20:, 0]).max() < 0.05 < np.abs(x[:, 0]).max()  # the platform reaches the target


def test_target_has_the_deviations_of_the_scenario():
    P, noise = np.zeros((3, 3)), np.diag(np.array(SCENARIOS["camera-target/following"].truth.process_std) ** 2)
    for _ in range(2000):
        P = PHI @ P @ PHI.T + noise
    np.testing.assert_allclose(np.sqrt(np.diag(P)[1:]), [0.29, 0.45], atol=5e-3)
