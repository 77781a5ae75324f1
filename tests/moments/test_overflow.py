"""An observer whose numbers overflow leaves the exact answers of the others of its cell as they are without it."""

from pathlib import Path

import numpy as np
import pytest
from support import own_observer

import pcbench
from pcbench.errors import UserError
from pcbench.moments import exactness
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("in_a_hurry")

WILD = f"{Path(own_observer.__file__)}:nudge"
STUDY = {
    "name": "overflow",
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "tick": 0.1, "duration": 9.0,
        "steady_start": 3.0,
        "noise_std": 0.3, "sampling_period": 0.2, "delay": 0.1, "states": ["a"], "input": "sine",
    },
}  # fmt: skip


def study(options, *observers):
    return STUDY | {"observers": list(observers), "options": options}


def exact_stats(options, *observers):
    return (
        pcbench.exact_moments(study(options, *observers)).stats.set_index(["observer", "metric"])["mean"].sort_index()
    )


@pytest.mark.ci
def test_an_observer_that_overflows_leaves_the_others_as_they_are():
    alone, both = exact_stats({}, "kf", "model-only"), exact_stats({"nudge": {"share": 1e11}}, "kf", WILD, "model-only")
    assert np.isnan(both["nudge", "mse"]), "there, with its reason"
    stats = pcbench.exact_moments(study({"nudge": {"share": 1e11}}, WILD)).stats
    (reason,) = stats[stats["metric"] == "mse"]["reason"]
    assert "a grows beyond what a number can hold within six" in reason, "no number is nan"
    for name in ("kf", "model-only"):  # before it and behind it
        assert np.isfinite(alone[name, "steady_mse"])
        np.testing.assert_allclose(both[name], alone[name], rtol=1e-12)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("run", "said"), [(3.0, "is not affine in the noise: a is off by more than"), (np.inf, "may leave")]
)
def test_where_linear_maps_overflow_and_the_run_does_not_an_observer_is_not_affine(run, said):
    """As of a sliding mode, whose slope is wild and whose runs are not: it was said to leave its bound."""
    (m,) = pcbench.exact_moments(study({}, "kf")).solve_cells(parse.grid(study({}, "kf"), "", parse.FROM_HERE).cells)
    assert exactness.refusal(m, "kf") == ""
    size, beyond = np.full_like(m.sums.size, run), np.full_like(m.sums.size, np.inf)
    sums = m.sums._replace(size=size, deviation=beyond, reach=beyond)
    assert said in exactness.refusal(m._replace(sums=sums), "kf")


@pytest.mark.nightly
def test_bands_in_time_are_those_without_it():
    each = [
        pcbench.exact_moments(asked).moments()
        for asked in (study({}, "kf"), study({"nudge": {"share": 1e11}}, "kf", WILD))
    ]
    alone, both = (m[m.observer == "kf"][["t", "mean", "std"]].to_numpy() for m in each)
    assert len(both) == 91
    np.testing.assert_allclose(both, alone, rtol=1e-12)


@pytest.mark.ci
def test_a_joint_covariance_names_the_observer_that_overflows():
    """Its numbers spoil those of the others there."""
    with pytest.raises(UserError, match=r"covariance: .*: nudge .*grows beyond what a number can hold"):
        pcbench.exact_moments(study({"nudge": {"share": 1e11}}, "kf", WILD)).covariance()
