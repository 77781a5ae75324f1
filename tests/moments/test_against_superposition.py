"""Three states, two channels with clocks of their own, late, a random start: against impulses sent one by one in NumPy."""

import numpy as np
import pytest
from harness import ODD
from reference import linear, moments

import pcbench

pytestmark = pytest.mark.usefixtures("in_a_hurry")

N, TICK, TE, LATE = 200, 0.01, [13, 7], [9, 9]
NOISE, X0, XHAT0, PRIOR = [0.3, 0.2], [0.5, -0.2, 0.3], [0.1, 0.1, -0.2], [0.4, 0.3, 0.5]
STUDY = {
    "name": "odd",
    "observers": ["kf", "model-only"],
    "lti": {
        "A": ODD.A.tolist(), "B": ODD.B.tolist(), "C": ODD.C.tolist(), "x0": X0, "xhat0": XHAT0, "prior_std": PRIOR,
        "tick": TICK, "duration": N * TICK, "steady_start": 0.5, "noise_std": NOISE, "sampling_period": [t * TICK for t in TE],
        "delay": [d * TICK for d in LATE], "states": ["a", "b", "c"], "input": "sine,sawtooth",
    },
    "options": {"scenario": {"random_initial_state": True}, "kf": {"R": [0.1, 0.05]}},
}  # fmt: skip


@pytest.fixture(scope="module")
def joint(in_a_hurry):
    return pcbench.exact_moments(STUDY).covariance()


@pytest.fixture(scope="module")
def expected():
    """Mean [N+1, 6] and covariance [N+1, 6, 6] of kf's error and the model's own."""
    model, P0 = linear.Model(ODD.A, ODD.B, ODD.C, TICK), np.diag(np.square(PRIOR))
    driven = pcbench.simulate(STUDY, "model-only")[["u1", "u2"]].to_numpy()

    def error_of(u, start, xhat0, noise):
        x, samples = linear.simulate(model, u, start, TE, LATE, noise)
        filtered = linear.kf(model, u, samples, xhat0, P0, np.array([0.1, 0.05]))
        return np.hstack([x - filtered, x - linear.model_only(model, u, xhat0)])

    counts = moments.sample_counts(N, TE, LATE)
    found = moments.error_map(error_of, driven, np.array(XHAT0), np.array(XHAT0), counts)
    return found.base, moments.covariance(found, np.repeat(NOISE, counts), P0)


@pytest.mark.ci
def test_mean_and_joint_covariance_of_two_observers_are_those_of_impulses(joint, expected):
    """1e-10 of what there is: the mean is rounding, as the start is random about the estimate."""
    assert joint.errors == tuple((o, s) for o in ("kf", "model-only") for s in "abc")
    np.testing.assert_allclose(joint.mean, expected[0], atol=1e-13)
    np.testing.assert_allclose(joint.covariance, expected[1], rtol=1e-10, atol=1e-13)
