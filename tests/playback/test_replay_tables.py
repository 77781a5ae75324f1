"""The tables of a replay: innovations are those of the textbook filter, and the smoothed states those of the smoother."""

import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from logged import MOTOR
from reference.late import Plant
from reference.linear import Model, Sample
from reference.surprise import joint

import pcbench
from pcbench.playback import replay_metrics, smoother
from pcbench.recordings import tables

TWO = {
    "name": "two-sensors",
    "lti": {
        "A": [[0.0, 1.0], [-2.0, -3.0]],
        "B": [[0.0], [1.0]],
        "C": [[1.0, 0.0], [0.3, 2.0]],
        "states": ["angle [rad]", "rate [rad/s]"],
        "tick": 0.01,
        "sampling_period": [0.05, 0.02],
        "delay": [0.04, 0.0],
        "delay_jitter": [0.08, 0.0],
        "noise_std": [0.1, 0.2],
        "process_std": [0.01, 0.05],
        "duration": 2.0,
        "input": "sine",
    },
}


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """A recording with out-of-sequence measurements, and the folder of its replay."""
    folder = tmp_path_factory.mktemp("two")
    pcbench.simulate(TWO, "kf", seed=5, log=folder / "log")
    found = pcbench.replay(folder / "log", TWO, ["kf", "model-only"], out=folder / "out")
    return folder, found


def arrivals(folder):
    """The rows of a recording that arrived, oldest first at equal times of arrival."""
    rows = pd.read_parquet(folder / "log" / "measurements.parquet").dropna(subset="arrived")
    return rows.sort_values(["arrived", "sampled", "channel"], kind="stable").reset_index(drop=True)


def joint_of(folder, rows):
    """The mean and the covariance of all values, as one normal vector."""
    (inputs,) = tables.open_tables(folder / "log").inputs.read()
    A, B, C = (np.array(TWO["lti"][k]) for k in "ABC")
    taken, channel = np.rint(rows.sampled / 0.01).astype(int), rows.channel.map({"y1": 0, "y2": 1})
    samples = [Sample(k, k, j, 0, y) for k, j, y in zip(taken, channel, rows.value, strict=True)]
    plant = Plant(Model(A, B, C, 0.01), inputs.values, np.eye(2))
    plant.Q = np.diag(np.square(TWO["lti"]["process_std"]))  # of a tick
    return joint(plant, samples, np.zeros(2), np.eye(2), np.square(TWO["lti"]["noise_std"]))


@pytest.mark.ci
def test_innovations_are_conditional_means_given_all_that_arrived_before(replayed):
    """Of a joint normal vector: nu is the value minus its conditional mean, from the Cholesky factor of the covariance."""
    folder, _ = replayed
    rows = arrivals(folder)
    mean, S = joint_of(folder, rows)
    L = np.linalg.cholesky(S)
    nu = np.diag(L) * np.linalg.solve(L, rows.value.to_numpy() - mean)
    found = pd.read_parquet(folder / "out" / "innovations.parquet")
    assert (found.arrived.diff() < 0).sum() == 0
    assert (found.sampled.diff() < 0).sum() > 20, "many are out of sequence"
    for name in ("sampled", "arrived", "value"):
        np.testing.assert_allclose(found[name], rows[name], rtol=0, atol=1e-12)
    assert list(found.channel) == list(rows.channel)
    np.testing.assert_allclose(found["kf.innovation"], nu, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found["kf.innovation.sigma"], np.diag(L), rtol=1e-10)
    assert not [name for name in found.columns if name.startswith("model-only")]


@pytest.mark.ci
def test_innovations_sum_to_the_likelihood_and_the_nis(replayed):
    folder, result = replayed
    found = pd.read_parquet(folder / "out" / "innovations.parquet")
    for row in result.innovations.to_dict("records"):
        nu, s = found[f"{row['observer']}.innovation"], found[f"{row['observer']}.innovation.sigma"]
        assert row["nis"] == pytest.approx(np.mean((nu / s) ** 2), rel=1e-12)
        assert row["log_likelihood"] == pytest.approx(np.mean(-0.5 * np.log(2 * np.pi * s**2) - 0.5 * (nu / s) ** 2))


@pytest.mark.ci
def test_summary_has_what_a_page_needs(replayed):
    folder, result = replayed
    about = json.loads((folder / "out" / "replay.json").read_text())
    assert about == result.summary | {key: about[key] for key in ("innovations", "channels", "distances", "metrics")}
    assert about["outputs"] == [
        {"channel": "y1", "unit": "rad", "state": "angle"},
        {"channel": "y2", "unit": "", "state": ""},
    ]
    assert (about["steady_start"], about["held_out_from"]) == (
        0.6,
        pytest.approx(0.7 * about["ticks"] * 0.01, abs=0.01),
    )


@pytest.mark.ci
def test_smoothed_states_are_written_and_an_earlier_replays_are_removed(replayed, monkeypatch, tmp_path):
    folder, result = replayed
    smoothed = pd.read_parquet(folder / "out" / "smoothed.parquet")
    estimates = pd.read_parquet(folder / "out" / "estimates.parquet")
    e = (estimates["kf.rate"] - smoothed.rate)[smoothed.t >= 0.6 - 1e-9]
    assert result.distances.set_index(["observer", "signal"]).rms["kf", "rate"] == pytest.approx(np.sqrt(np.mean(e**2)))
    assert pq.read_schema(folder / "out" / "smoothed.parquet").field("rate").metadata[b"unit"] == b"rad/s"
    (tmp_path / "smoothed.parquet").write_text("of an earlier replay")
    monkeypatch.setattr(smoother.memory, "free", lambda: 1 << 14)
    pcbench.replay(folder / "log", TWO, "kf", out=tmp_path)
    assert not (tmp_path / "smoothed.parquet").exists()


def test_distance_of_a_recording_shorter_than_the_transient_is_unknown(tmp_path):
    table = pd.DataFrame({"t": [0.0, 0.1], "kf.x": [1.0, 2.0]})
    table.to_parquet(tmp_path / "e.parquet")
    for steady, rms in ((0, np.sqrt(2.5)), (1, 2.0), (2, np.nan), (9, np.nan)):
        (got,) = replay_metrics.distances(tmp_path / "e.parquet", np.zeros((2, 1)), ["kf"], (("x", "m"),), steady).rms
        assert got == pytest.approx(rms, nan_ok=True)


@pytest.mark.ci
def test_columns_of_truth_are_those_that_the_recording_has(tmp_path):
    pcbench.simulate(MOTOR, "kf", seed=1, log=tmp_path)
    truth = pd.read_parquet(tmp_path / "truth.parquet")
    truth[["t", "rate"]].to_parquet(tmp_path / "truth.parquet", index=False)
    found = pcbench.replay(tmp_path, MOTOR, "kf").estimates
    assert list(found.columns) == ["t", "rate", "kf.angle", "kf.rate", "kf.angle.sigma", "kf.rate.sigma"]
    np.testing.assert_allclose(found.rate, truth.rate, rtol=0, atol=1e-14)
