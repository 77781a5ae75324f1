"""A cell's observers go by themselves where they remember much: the same numbers, and one program for what differs in gains."""

import numpy as np
import pytest

import pcbench
from pcbench.moments import programs, solve
from pcbench.runtime import program_cache

pytestmark = pytest.mark.usefixtures("in_a_hurry")

STUDY = {
    "name": "apart",
    "observers": ["kf", "kf-wary", "model-only"],
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "tick": 0.1, "duration": 3.0,
        "steady_start": 1.0,
        "noise_std": 0.3, "sampling_period": 0.4, "delay": 0.2, "states": ["a"], "input": "sine",
    },
    "options": {"kf": {"R": 0.1}, "kf-wary": {"R": 3.0}},
}  # fmt: skip


def stats():
    return pcbench.exact_moments(STUDY).stats.set_index(["observer", "signal", "metric"])["mean"]


@pytest.mark.nightly
def test_apart_or_together_the_numbers_are_the_same_and_two_of_a_kind_share_a_program(monkeypatch):
    exact = pcbench.exact_moments(STUDY)
    joint, apart = exact.covariance(), exact.moments()
    monkeypatch.setattr(programs, "_PROGRAMS", program_cache.Programs())
    own = stats()
    assert own["kf", "a", "mse"] != own["kf-wary", "a", "mse"]
    assert len(programs._PROGRAMS) == 2, "kf and kf-wary are one"
    for i, (observer, _) in enumerate(joint.errors):
        mine = apart[apart["observer"] == observer]
        np.testing.assert_allclose(mine["mean"], joint.mean[:, i], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(mine["std"], np.sqrt(joint.covariance[:, i, i]), rtol=1e-12, atol=1e-15)


@pytest.mark.ci
def test_packets_that_noise_reaches_take_the_room_of_their_cell_alone(monkeypatch):
    """Delays of one and of seven samples, so that the small ring is gone round many times beside the large one."""
    study = STUDY | {"axes": {"delay": [0.4, 2.8]}, "observers": ["kf"], "options": {"kf": {"R": 0.1}}}
    study |= {"lti": STUDY["lti"] | {"process_std": 0.2, "duration": 6.0}}
    rings, compute = [], solve.compute

    def noted(ones, *how):
        rings.append(ones[0].layout.ring)
        return compute(ones, *how)

    monkeypatch.setattr(solve, "compute", noted)
    own = pcbench.exact_moments(study).stats
    assert sorted(rings) == [2, 8]
    monkeypatch.setattr(solve, "_noise_in_flight", lambda p: False)
    np.testing.assert_allclose(pcbench.exact_moments(study).stats["mean"], own["mean"], rtol=1e-12, atol=1e-15)
    assert sorted(rings) == [2, 8, 8]
