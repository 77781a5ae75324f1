"""Exact moments of closed loops with each built-in controller, against superposition in NumPy, through every way to ask."""

import numpy as np
import pytest
import tomli_w
from commands import call
from loops import resting
from reference import loop, superposition
from scipy.linalg import expm

import pcbench
from pcbench.dataset import validate_exact

pytestmark = pytest.mark.usefixtures("in_a_hurry")

A, B, C = np.array([[0.0, 1.0], [2.0, -0.5]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
TICK, N, TAIL, LATE = 0.02, 60, 30, 2
NOISE, PROCESS, X0, XHAT0, PRIOR = 0.01, [0.0, 0.02], [0.2, -0.1], [0.15, 0.0], [0.1, 0.2]
K = [[6.0, 3.0]]
SENSOR = loop.Network(5, 3)
LTI = {
    "A": A.tolist(), "B": B.tolist(), "C": C.tolist(), "tick": TICK, "duration": N * TICK, "steady_start": TAIL * TICK,
    "sampling_period": 0.1, "delay": 0.06, "noise_std": NOISE, "process_std": PROCESS, "x0": X0, "xhat0": XHAT0,
    "prior_std": PRIOR, "states": ["angle", "rate"],
}  # fmt: skip
COMMON = {"actuator_delay": LATE * TICK, "period": 2 * TICK, "set_point": {"angle": {"step": 0.3, "at": 0.4}}}
CONTROLLERS = {
    "lqr": {"use": "lqr", "Q1": [10.0, 1.0], "Q2": 0.1},
    "state-feedback": {"use": "state-feedback", "K": K},
    "pid": {"use": "pid", "Kp": 6.0, "Ki": 1.5, "Kd": 3.0, "filter": 0.04},
}


def study(name):
    options = {"scenario": {"random_initial_state": True}}
    controller = CONTROLLERS[name] | COMMON
    return {"name": "t", "seeds": 64, "observers": ["kf"], "lti": LTI, "controller": controller, "options": options}


def plant():
    whole = expm(TICK * np.block([[A, B], [np.zeros((1, 3))]]))
    return loop.Plant(
        whole[:2, :2], whole[:2, 2:], C, np.array([NOISE]), np.array(PROCESS), np.array(XHAT0), np.array(XHAT0),
        np.diag(np.square(PRIOR)),
    )  # fmt: skip


def aims(p, M):
    """The set point and its steady input as coefficients."""
    r = np.where(TICK * np.arange(2 * N) >= 0.4 - 1e-9, 0.3, 0.0)[:, None]
    return (superposition.constants(a, M) for a in resting(p, r, [0]))


def law(name, p, M):
    x_ref, u_ref = aims(p, M)
    if name == "pid":
        return loop.Pid(*(np.array([[a]]) for a in (6.0, 1.5, 3.0)), 2 * TICK, 0.04, x_ref)
    if name == "state-feedback":
        return loop.Feedback(np.array(K), x_ref, u_ref)
    Phi, Gamma = np.linalg.matrix_power(p.Phi, 2), p.Gamma + p.Phi @ p.Gamma
    return loop.Feedback(loop.lqr(Phi, Gamma, np.diag([10.0, 1.0]), np.array([[0.1]])), x_ref, u_ref, ahead=LATE)


def reference_means(name):
    """By metric: means over the ticks of the horizon and of its tail."""
    p = plant()
    M = 1 + 2 + 2 * N + -(-N // SENSOR.every)
    found = superposition.coefficients(p, SENSOR, law(name, p, M), N, every=2, late=LATE)
    x_ref, u_ref = aims(p, M)
    out = {}
    for prefix, first in (("", 0), ("steady_", TAIL)):
        x, u, e = (found.x - x_ref[:N])[first:], found.u[first:], (found.x - found.xhat)[first:]
        for i, signal in enumerate(LTI["states"]):
            out[signal, prefix + "mse"] = np.square(e[:, i]).sum(-1).mean()
            out[signal, prefix + "pooled_tracking_rmse"] = np.sqrt(np.square(x[:, i]).sum(-1).mean())
        out["angle", prefix + "pooled_input_rms"] = np.sqrt(np.square(u).sum((1, 2)).mean())
        if name == "lqr":
            cost = superposition.square(np.diag([10.0, 1.0]), x) + superposition.square(
                np.array([[0.1]]), u - u_ref[first:N]
            )
            out["angle", prefix + "lq_cost"] = cost.mean()
    return out


@pytest.mark.ci
@pytest.mark.parametrize("name", list(CONTROLLERS))
def test_exact_loop_agrees_with_superposition_and_with_its_runs(name, tmp_path):
    """1e-9, where 60 ticks in double precision leave 1e-13."""
    exact, want = pcbench.exact_moments(study(name)).stats, reference_means(name)
    found = exact[exact.method == "exact"].set_index(["signal", "metric"])["mean"]
    assert {key: found[key] for key in want} == pytest.approx(want, rel=1e-9)
    stored = pcbench.run(study(name), evaluation="exact", out=tmp_path / "exact").stats
    np.testing.assert_allclose(stored["mean"], exact["mean"], rtol=1e-12, atol=1e-14)
    pcbench.run(study(name), out=tmp_path / "runs")
    checked = validate_exact.check(tmp_path / "runs")
    assert len(checked.rows) == (12 if name == "lqr" else 10)
    assert checked.wrong.empty, checked.verdict
    assert not checked.refusals


@pytest.mark.ci
def test_run_exact_of_a_loop_prints_its_cost(tmp_path):
    (tmp_path / "loop.toml").write_text(tomli_w.dumps(study("lqr")))
    done = call("run", "loop.toml", "--evaluation", "exact", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "lq_cost" in done.stdout
