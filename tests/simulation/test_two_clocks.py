"""Two clocks that sample at the same ticks, with losses and jitter: cloning equals the optimum, and a run equals its trace."""

import numpy as np
import pytest

import pcbench

STUDY = {
    "name": "twoclocks",
    "lti": {
        "A": [[0.0, 1.0], [-2.0, -0.6]],
        "B": [[0.0], [1.5]],
        "C": [[1.0, 0.0], [0.0, 1.0]],
        "sampling_period": 0.1,
        "delay": [0.02, 0.05],
        "noise_std": [0.3, 0.4],
        "process_std": [0.02, 0.05],
        "tick": 0.01,
        "duration": 1.0,
    },
    "options": {"scenario": {"random_initial_state": True}},
    "axes": {"loss": [0.1], "delay_jitter": [0.03]},
}
CLONES = ["kf-cloning", "kf-larsen", "kf-alexander"]


def same_as_traces(observers, seeds):
    """Compare the rms error of each run with that of its trace; return the former, [observer, seed, signal]."""
    study = STUDY | {"observers": observers}
    runs = pcbench.run(study, seeds=seeds).runs.set_index(["observer", "seed", "signal"])["rmse"]
    for seed in range(seeds):
        table = pcbench.simulate(study, observers, seed=seed)[:-1]
        for name in observers:
            for signal in ("x1", "x2"):
                e = table[signal] - table[f"{name}.{signal}"]
                np.testing.assert_allclose(runs[name, seed, signal], np.sqrt(np.mean(e**2)), rtol=1e-10)
    return runs


@pytest.mark.ci
def test_cloning_equals_the_optimum_run_by_run_and_runs_equal_traces():
    rmse = same_as_traces(["kf", "kf-cloning"], 2)
    np.testing.assert_allclose(rmse["kf-cloning"], rmse["kf"], rtol=1e-10)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "observers", [CLONES, ["ekf", "ekf-delay"], ["ekf-iterated", "ukf"], ["kf-reprocess", "oosm-a1", "oosm-b1"]]
)
def test_runs_equal_traces(observers):
    same_as_traces(observers, 3)
