"""Exact moments keep their digits if the start is far larger than the errors, against the information form in NumPy."""

import numpy as np
import pytest
from scipy.linalg import expm

import pcbench
from pcbench.dataset import validate_exact

pytestmark = pytest.mark.usefixtures("in_a_hurry")

TICK, N, TAIL, EVERY, LATE, NOISE = 0.05, 60, 30, 4, 3, 1e-3
PLANTS = {
    "integrator": ([[0.0]], [[1.0]], [1e5], [0.0]),
    "unstable": ([[0.0, 1.0], [4.0, 0.0]], [[0.0], [1.0]], [1e4, 3e3], [0.0, 0.0]),
    "operating": ([[0.0, 1.0], [-2.0, -0.4]], [[0.0], [1.0]], [1e2, 2e2], [3e6, -1e6]),
}


def study(name, **more):
    A, B, prior, x0 = PLANTS[name]
    lti = {
        "A": A, "B": B, "C": [[1.0] + [0.0] * (len(A) - 1)], "tick": TICK, "duration": N * TICK,
        "steady_start": TAIL * TICK, "x0": x0,
        "xhat0": x0, "divergence_threshold": 1e9,
        "sampling_period": EVERY * TICK, "delay": LATE * TICK, "noise_std": NOISE, "prior_std": prior, "input": "sine",
    }  # fmt: skip
    return {
        "name": "t",
        "observers": ["kf"],
        "options": {"scenario": {"random_initial_state": True}},
        "lti": lti,
    } | more


def reference_rms(name):
    """The root mean square [n] over the tail: P^-1 is P0^-1 and what each measurement that has arrived adds to it."""
    A, _, prior, _ = PLANTS[name]
    n, out = len(A), []
    for k in range(TAIL, N):
        back = expm(-np.array(A) * TICK * k)
        information = back.T @ np.diag(1 / np.square(prior)) @ back
        for taken in range(0, k - LATE + 1, EVERY):
            row = expm(np.array(A) * TICK * (taken - k))[0]
            information = information + np.outer(row, row) / NOISE**2
        out.append(np.diag(np.linalg.solve(information, np.eye(n))))
    return np.sqrt(np.mean(out, 0))


def pooled(stats):
    return stats[stats.metric == "steady_pooled_rmse"]["mean"].to_numpy()


@pytest.mark.parametrize("name", [*list(PLANTS)[:2], pytest.param("operating", marks=pytest.mark.nightly)])
def test_exact_errors_keep_their_digits_beside_a_large_start(name):
    """The bound that `rms_efficiency` needs is a covariance recursion, which keeps eight digits, or six of an unstable plant's.

    The last of them depend on the processor.
    """
    stats = pcbench.exact_moments(study(name)).stats
    np.testing.assert_allclose(pooled(stats), reference_rms(name), rtol=1e-9)
    rtol = 1e-8 if name == "integrator" else 1e-5
    np.testing.assert_allclose(stats[stats.metric == "rms_efficiency"]["mean"], 1.0, rtol=rtol)


@pytest.mark.nightly
def test_exact_errors_keep_their_digits_in_a_loop():
    closed = study("unstable", controller={"use": "lqr", "Q1": [1.0, 1.0], "Q2": 1.0})
    del closed["lti"]["input"]
    np.testing.assert_allclose(pooled(pcbench.exact_moments(closed).stats), reference_rms("unstable"), rtol=1e-9)


@pytest.mark.nightly
def test_runs_agree_with_exact_errors_beside_a_large_start(tmp_path):
    pcbench.run(study("integrator", seeds=256), out=tmp_path / "runs")
    checked = validate_exact.check(tmp_path / "runs")
    assert checked.wrong.empty, checked.verdict
