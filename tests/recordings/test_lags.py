"""The lag between two channels of a recording: that of two sensors of one motion, and nothing of others."""

import json

import numpy as np
import pytest
from commands import call
from logged import rows
from scipy.ndimage import gaussian_filter1d
from scipy.stats import t as student

import pcbench
from pcbench.recordings import lags


def motion(seed):
    """A smooth random motion as a function of time."""
    t = np.arange(0.0, 60.0, 0.005)
    x = 20 * gaussian_filter1d(np.random.default_rng(seed).normal(size=len(t)), 60)
    return lambda at: np.interp(at, t, x)


def recording(folder, seed, late, other=None, factor=-2.0):
    """Two sensors of one motion, or of two, the second one slower and stamped `late` [s] after it measures."""
    random = np.random.default_rng(1000 + seed)
    a, b = np.arange(1.0, 59.0, 0.02), np.arange(1.0, 59.0, 0.05) + random.uniform(0, 0.05)
    values = motion(seed)(a), factor * motion(seed if other is None else other)(b)
    columns = {
        "channel": ["y1"] * len(a) + ["y2"] * len(b),
        "sampled": np.concatenate([a, b + late]),
        "value": np.concatenate(values) + 0.02 * random.normal(size=len(a) + len(b)),
    }
    columns["arrived"] = columns["sampled"] + 0.2
    return rows(folder, columns)


@pytest.mark.parametrize(("late", "factor"), [(0.083, -2.0), (-0.12, 1.0)])
def test_lag_of_two_sensors_of_one_motion_is_found(tmp_path, late, factor):
    (one,) = pcbench.info(recording(tmp_path / "log", 4, late, factor=factor)).attrs["lags"]
    assert (one.first, one.second) == ("y1", "y2")
    assert one.lag == pytest.approx(late, abs=2e-3)
    assert one.low <= late <= one.high
    assert one.high - one.low < 0.01
    assert np.sign(one.correlation) == np.sign(factor)


def test_channels_of_different_motions_have_no_lag(tmp_path):
    assert pcbench.info(recording(tmp_path / "log", 4, 0.1, other=5)).attrs["lags"] == []


def test_lag_with_an_interval_of_half_the_range_is_left_out(monkeypatch, tmp_path):
    folder = recording(tmp_path / "log", 4, 0.083)
    monkeypatch.setattr(lags, "T9", 1e4)
    assert pcbench.info(folder).attrs["lags"] == []


@pytest.mark.ci
def test_intervals_hold_the_lag_in_at_least_34_of_40_recordings(tmp_path):
    """95 % intervals hold it in fewer with a probability of 0.003."""
    held = 0
    for seed in range(40):
        late = float(np.random.default_rng(seed).uniform(-0.15, 0.15))
        (one,) = pcbench.info(recording(tmp_path / str(seed), seed, late)).attrs["lags"]
        held += one.low <= late <= one.high
    assert held >= 34
    assert pytest.approx(student(lags.BLOCKS - 1).ppf(0.975)) == lags.T9


def test_short_channels_are_not_compared(tmp_path):
    t = np.arange(30) * 0.1
    columns = {
        "channel": ["y1"] * 30 + ["y2"] * 30,
        "sampled": [*t, *t],
        "arrived": [*t, *t],
        "value": [*np.sin(t)] * 2,
    }
    assert pcbench.info(rows(tmp_path / "log", columns)).attrs["lags"] == []


@pytest.mark.ci
def test_info_prints_lags(tmp_path):
    recording(tmp_path / "log", 4, 0.083)
    assert "y2 is 0.08" in call("info", "log", cwd=tmp_path).stdout
    (one,) = json.loads(call("info", "log", "--json", cwd=tmp_path).stdout)["lags"]
    assert one["low"] <= 0.083 <= one["high"]
