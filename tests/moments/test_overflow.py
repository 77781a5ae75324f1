"""An observer whose numbers overflow leaves the exact answers of the others of its cell as they are without it."""

from pathlib import Path

import numpy as np
import pytest
from support import own_observer

import pcbench

pytestmark = pytest.mark.usefixtures("in_a_hurry")

WILD = f"{Path(own_observer.__file__)}:nudge"
STUDY = {
    "name": "overflow",
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "tick": 0.1, "horizon": 9.0, "tail": 3.0,
        "noise_std": 0.3, "sampling_period": 0.2, "delay": 0.1, "states": ["a"], "input": "sine",
    },
}  # fmt: skip


def study(options, *observers):
    return STUDY | {"observers": list(observers), "options": options}


def found(options, *observers):
    return pcbench.exact(study(options, *observers)).stats.set_index(["observer", "metric"])["mean"].sort_index()


def test_an_observer_that_overflows_leaves_the_others_as_they_are():
    alone, both = found({}, "dkf", "open-loop"), found({"nudge": {"share": 1e11}}, "dkf", WILD, "open-loop")
    assert np.isnan(both["nudge", "mse"]), "there, with its reason"
    stats = pcbench.exact(study({"nudge": {"share": 1e11}}, WILD)).stats
    (reason,) = stats[stats["metric"] == "mse"]["reason"]
    assert "a grows beyond what a number can hold within six" in reason, "no number is nan"
    for name in ("dkf", "open-loop"):  # before it and behind it
        assert np.isfinite(alone[name, "tail_mse"])
        np.testing.assert_allclose(both[name], alone[name], rtol=1e-12)


@pytest.mark.slow
def test_bands_in_time_are_those_without_it():
    each = [
        pcbench.exact(asked).moments() for asked in (study({}, "dkf"), study({"nudge": {"share": 1e11}}, "dkf", WILD))
    ]
    alone, both = (m[m.observer == "dkf"][["t", "mean", "std"]].to_numpy() for m in each)
    assert len(both) == 91
    np.testing.assert_allclose(both, alone, rtol=1e-12)
