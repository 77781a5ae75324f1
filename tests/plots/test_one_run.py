"""A run that is shown in time is the trace of the study's first seed in its first cell, thinned over the whole of it."""

import numpy as np
import pytest

import pcbench
from pcbench.machine import process
from pcbench.plots import one_run
from pcbench.study import read


@pytest.fixture(scope="module")
def shown():
    raw = {"name": "t", "scenarios": ["cart/white"], "observers": ["pccebo"], "seeds": 3, "first_seed": 6}
    made = read.parse(raw | {"axes": {"noise_std": [0.3, 0.5], "delay": [0.1]}}, "t")
    with process.float64():
        trace = pcbench.trace("cart/white", "pccebo", seed=6, overrides=["axes.noise_std=0.3", "axes.delay=0.1"])
        return one_run.of(made, "cart/white", None), trace


def test_it_is_thinned_evenly_from_the_start_to_the_end(shown):
    frame, trace = shown
    for _, mine in frame.groupby(["signal", "series"]):
        assert len(mine) <= one_run.POINTS
        t = mine.t.to_numpy()
        assert t[0] == 0
        assert t[-1] > 0.99 * trace.t.iloc[-1]
        np.testing.assert_allclose(np.diff(t), t[1], rtol=1e-9)


def test_its_values_are_those_of_the_trace(shown):
    frame, trace = shown
    columns = {
        ("position", "plant", "truth"): "position",
        ("velocity", "plant", "truth"): "velocity",
        ("position", "pccebo", "estimate"): "pccebo.position",
        ("velocity", "pccebo", "estimate"): "pccebo.velocity",
        ("position", "measured", "measured"): "y1",
    }
    found = dict(list(frame.groupby(["signal", "series", "kind"])))
    assert set(found) == set(columns)
    for key, column in columns.items():
        at = np.round(found[key].t.to_numpy() / 1e-3).astype(int)
        np.testing.assert_array_equal(found[key].value, trace[column].to_numpy()[at])
