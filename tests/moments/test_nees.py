"""How wrong an observer believes to be against how wrong it is, exactly: by impulses and conditioning in NumPy, and by runs."""

import numpy as np
import pytest
from harness import ODD
from reference import linear, surprise
from scipy.stats import norm
from test_against_superposition import LATE, PRIOR, STUDY, TE, TICK, N, expected  # noqa: F401

import pcbench
from pcbench.moments import nees
from pcbench.moments.nees import FinalErrors

pytestmark = pytest.mark.usefixtures("in_a_hurry")

CHOICES = {"random_initial_state": True, "consistency": True}
ASKED = STUDY | {"observers": ["kf"], "options": STUDY["options"] | {"scenario": CHOICES}}
SCALAR = {
    "name": "scalar",
    "observers": ["kf", "kf-alexander"],
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [0.4], "xhat0": [0.0], "prior_std": [1.0], "tick": 0.1,
        "duration": 6.0, "steady_start": 2.0, "noise_std": [0.3], "sampling_period": 0.5, "delay": 0.3, "states": ["a"],
        "process_std": [0.1],
    },
    "options": {"scenario": CHOICES, "kf": {"R": 0.03}},
}  # fmt: skip


def exact_values(study):
    """The exact numbers by observer, metric, signal."""
    stats = pcbench.exact_moments(study).stats
    return stats[stats.method == "exact"].set_index(["observer", "metric", "signal"]).sort_index()["mean"]


@pytest.mark.nightly
def test_expected_squares_are_those_of_the_reference(expected):  # noqa: F811
    """Told R = (0.1, 0.05) where (0.09, 0.04) is true: a little pessimistic."""
    exact = exact_values(ASKED)
    u = pcbench.simulate(STUDY, "model-only")[["u1", "u2"]].to_numpy()
    plant = surprise.Plant(linear.Model(ODD.A, ODD.B, ODD.C, TICK), u, np.zeros((3, 3)))
    _, samples = linear.simulate(linear.Model(ODD.A, ODD.B, ODD.C, TICK), u, np.zeros(3), TE, LATE)
    P = surprise.posterior(plant, samples, np.diag(np.square(PRIOR)), np.array([0.1, 0.05]), N - 1)
    true = expected[1][N - 1, :3, :3]
    assert exact["kf", "nees", "a"] == pytest.approx(np.trace(np.linalg.solve(P, true)) / 3, rel=1e-10)
    assert exact["kf", "nees", "a"] < 0.9
    parts = np.diag(true) / np.diag(P)
    np.testing.assert_allclose(exact["kf", "signal_nees"][["a", "b", "c"]], parts, rtol=1e-10)
    for k in (1, 2, 3):
        share = 2 * norm.cdf(k / np.sqrt(parts)) - 1
        np.testing.assert_allclose(exact["kf", f"coverage_{k}_sigma"][["a", "b", "c"]], share, rtol=1e-10)
    assert exact["kf", "nees_dof", "a"] == 3


@pytest.mark.ci
def test_runs_come_to_it_and_who_is_told_when_a_sample_is_taken_is_told_here_too():
    """With one sample on its way at a time Alexander's filter is the optimum once it has arrived, as it has at the last tick.

    Three standard errors of 256 runs, whose seeds are written.
    """
    exact = exact_values(SCALAR)
    runs = pcbench.run(SCALAR, seeds=256).stats.set_index(["observer", "metric", "signal"])
    for key in (("kf", "nees", "a"), ("kf-alexander", "nees", "a"), ("kf-alexander", "steady_mse", "a")):
        assert abs(runs["mean"][key] - exact[key]) < 3 * runs["se"][key], key
    assert exact["kf-alexander", "nees", "a"] == pytest.approx(1.0, rel=1e-9)
    assert exact["kf", "nees", "a"] > 1.3


@pytest.mark.nightly
def test_all_that_are_told_are():
    """The true model's filter with a copy of the state for each sample is the optimum, and Larsen's believes what is so."""
    names = ["kf", "kf-cloning", "kf-larsen", "kf-alexander", "model-only"]
    options = STUDY["options"] | {"scenario": CHOICES, "kf": {}}
    exact = exact_values(STUDY | {"observers": names, "options": options})
    error = exact[:, "steady_pooled_rmse", "a"]
    assert error["kf-cloning"] == pytest.approx(error["kf"], rel=1e-8)
    assert error["kf"] < error["kf-larsen"] < error["model-only"] / 2
    assert error["kf"] < error["kf-alexander"] < error["model-only"] / 2
    for observer in ("kf", "kf-cloning", "kf-larsen"):
        assert exact[observer, "nees", "a"] == pytest.approx(1.0, rel=1e-9)
    assert ("model-only", "nees", "a") not in exact.index


def test_what_is_known_counts_in_neither():
    e = FinalErrors(
        np.array([[0.5], [0.0]]), np.diag([2.0, 0.0])[..., None], np.diag([4.0, 1e-30])[..., None], np.ones(2)
    )
    found = nees.squares(e)
    assert found.nees.item() == pytest.approx(2.25 / 4)
    assert found.states.item() == 1
    assert np.isnan(found.signal[:, 0]).tolist() == [False, True]
    within = nees.inside(e)[0]
    assert within[0, 0] == pytest.approx(norm.cdf(1.5 / 2**0.5) - norm.cdf(-2.5 / 2**0.5))
    assert np.isnan(within[1, 0])
