"""Observers that must know when a sample is taken are told, on schedules that all runs share and on those of their own."""

import numpy as np
import pytest

import pcbench

AXES = [{"delay": [0.3], "loss": [0.3], "delay_jitter": [0.4]}, {"delay": [0.5]}]


@pytest.mark.nightly  # with less in the way: tests/observers/test_late_samples.py
@pytest.mark.parametrize("axes", AXES, ids=str)
def test_cloning_is_the_optimum_in_every_run(axes):
    runs = pcbench.run("cart/gaussian", observers=["kf", "kf-cloning"], seeds=3, axes=axes).runs
    wide = runs[runs.signal == "position"].set_index(["observer", "seed"])["steady_rmse"]
    np.testing.assert_allclose(wide["kf-cloning"], wide["kf"], rtol=1e-8)
    assert len(set(wide["kf"])) == len(wide["kf"]), "every run has its own samples"
