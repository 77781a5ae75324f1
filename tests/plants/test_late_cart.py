"""The cart under a camera of unknown delay: its run is SciPy's, its delay that of its samples; who knows it has no error."""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm

import pcbench

pytestmark = pytest.mark.usefixtures("in_a_hurry")
LATE, VARYING = 0.2, {"delay_jitter": 0.08, "loss": 0.3, "sampling_jitter": 0.02}
START = {"x0": [1.5, -20.0], "xhat0": [1.5, -20.0], "noise_std": [0.0], "assumed_delay_error": 0.0, "duration": 5.0}


MEANS = {LATE: {}, 0.24: VARYING}


@cache
def traced(mean, assumed):
    """A run from the true start without noise, of samples so late in the mean; `assumed`: their assumed mean delay."""
    options = {"mmae-delay": {"delays": [assumed]}, "ekf-delay": {"delay": assumed, "longest": 0.6}, "kf": {}}
    study = {
        "name": "perfect", "observers": list(options), "options": options,
        "scenario": {"base": "cart/unknown-delay", "steady_start": 1.0} | START | MEANS[mean],
    }  # fmt: skip
    return pcbench.simulate(study, list(options), seed=3)


def errors(mean, assumed, name):
    """The largest error of each signal over the signal's largest value."""
    signals, trace = ["position", "velocity", "delay"][: 2 if name == "kf" else 3], traced(mean, assumed)
    true = trace[signals].to_numpy()
    return np.abs(trace[[f"{name}.{of}" for of in signals]].to_numpy() - true).max(0) / np.abs(true).max(0)


@pytest.mark.ci
def test_its_run_is_scipys_and_its_delay_is_that_of_its_samples_in_the_mean():
    trace = traced(LATE, LATE)
    A, h = np.array([[0.0, 1.0, 0.0], [0.0, -122.0, 355.0], [0.0, 0.0, 0.0]]), 0.01
    E, x = expm(A * h), np.array(START["x0"])
    for k, u in enumerate(trace["u1"].to_numpy()):
        np.testing.assert_allclose(trace[["position", "velocity"]].iloc[k], x, rtol=0, atol=1e-11)
        x = E[:2] @ np.append(x, u)
    for mean in MEANS:
        np.testing.assert_allclose(traced(mean, mean)["delay"], mean, rtol=1e-12)


@pytest.mark.ci
@pytest.mark.parametrize("mean", MEANS)
@pytest.mark.parametrize("name", ["mmae-delay", "ekf-delay", "kf"])
def test_where_the_delay_is_known_from_a_perfect_start_there_is_no_error(name, mean):
    """Of the delay too, whether it varies or not; and if the assumed one is a tick off, the position has one."""
    assert errors(mean, mean, name).max() < 1e-12
    if name != "kf":
        assert errors(mean, mean + 0.01, name)[0] > 1e-4
