"""The leg's recording: what its README says of it, and its signals against NumPy."""

import numpy as np
import pandas as pd
import pytest
from reference import leg

import pcbench
from pcbench.cli import new

PLANT = {
    "name": "leg",
    "lti": {
        "A": [[0.0, 1.0], [0.0, 0.0]],
        "B": [[1.0], [0.0]],
        "C": [[1.0, 0.0]],
        "states": ["angle [rad]", "bias [rad/s]"],
        "xhat0": [-0.57, 0.0],
        "prior_std": [0.1, 0.1],
        "tick": 1 / 240,
        "sampling_period": 1 / 120,
        "delay": 0.05,
        "noise_std": 0.004,
        "process_std": [0.0014, 0.0],
        "duration": 30.0,
    },
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder that `pcbench new recording` writes."""
    here = tmp_path_factory.mktemp("here")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        new.new("recording", "walk", "leg")
    return here / "walk"


def columns(folder):
    frame = pd.read_csv(folder / "leg.csv")
    return frame.t.to_numpy(), *(frame[[f"{name}_{axis}" for axis in "xyz"]].to_numpy() for name in ("gyro", "mag"))


def test_command_writes_the_recording_with_its_source_and_licence(folder):
    assert {p.name for p in folder.iterdir()} == {"leg.csv", "recording.toml", "README.md", "LICENSE"}
    assert sum(p.stat().st_size for p in folder.iterdir()) < 200_000
    licence = (folder / "LICENSE").read_text()
    assert "Thomas Haslwanter" in licence
    assert licence.count("* ") == 3  # the conditions of the 3-clause BSD licence
    assert "scikit-kinematics" in (folder / "README.md").read_text()


def test_rows_are_those_of_its_readme(folder):
    t, w, m = columns(folder)
    assert len(t) == 3511
    assert np.abs(t - np.arange(3511) / leg.RATE).max() < 5.1e-6
    assert np.linalg.norm(m, axis=1).mean() == pytest.approx(1.0, abs=0.01)
    assert 5 < np.abs(w[:, 2]).max() < 6


def test_example_is_an_option_of_recordings_only(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(pcbench.UserError, match="new plant: got --example leg, which is an option of recordings"):
        new.new("plant", "walk", "leg")
    assert not list(tmp_path.iterdir())


@pytest.mark.ci
def test_replay_equals_a_filter_in_numpy(folder):
    """Of all rows, by the angle and its rate in NumPy: a tick at a time, with the rate held over both ticks of a row."""
    t, w, m = columns(folder)
    y, u = leg.angle(m), leg.rate(w, m)
    lti = PLANT["lti"]
    A, dt = np.array([[1.0, lti["tick"]], [0.0, 1.0]]), lti["tick"]
    x, P = np.array(lti["xhat0"]), np.diag(np.square(lti["prior_std"]))
    total = 0.0
    for value, rate in zip(y, u, strict=True):
        S = P[0, 0] + lti["noise_std"] ** 2
        total -= 0.5 * (np.log(2 * np.pi * S) + (value - x[0]) ** 2 / S)
        K = P[:, 0] / S
        x, P = x + K * (value - x[0]), P - np.outer(K, K) * S
        for _ in range(2):
            x, P = A @ x + [dt * rate, 0.0], A @ P @ A.T + np.diag(np.square(lti["process_std"]))
    (row,) = pcbench.replay(folder / "recording.toml", PLANT, "kf").innovations.to_dict("records")
    assert row["samples"] == len(t)
    assert row["log_likelihood"] == pytest.approx(total / len(t), rel=1e-10)
