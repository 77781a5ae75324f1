"""A run written as a log and read again gives the same estimates, to rounding, in every kind of table; and the same errors."""

import shutil

import jax
import numpy as np
import pandas as pd
import pytest
from logged import MOTOR, write_log

import pcbench
from pcbench.errors import UserError
from pcbench.playback import setup
from pcbench.recordings import tables
from pcbench.recordings.log import Batch

OBSERVERS = ["pccebo", "kf"]
WRONG = {"timestamp_offset": -0.04, "timestamp_jitter": 0.01}
STAMPED = MOTOR | {"lti": MOTOR["lti"] | WRONG}
WILD = MOTOR | {"lti": MOTOR["lti"] | {"delay_jitter": 0.15, "loss": 0.2, "sampling_jitter": 0.02}}


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """Runs of the motor, on time and late, lost and out of sequence: the frame and the folder of its log."""
    out = {}
    options = {"scenario": {"consistency": True, "random_initial_state": True}}  # traces have standard deviations, too
    for name, study in (("plain", MOTOR), ("wild", WILD), ("stamped", STAMPED)):
        study = study | {"options": options}
        folder = tmp_path_factory.mktemp(name)
        out[name] = study, pcbench.simulate(study, OBSERVERS, seed=3, log=folder), folder
    return out


def as_csv(folder, into):
    """The same log in the other kind of table."""
    log = tables.open_tables(folder)
    batch = Batch(*(np.concatenate(c) for c in zip(*log.measurements(), strict=True)))
    (inputs,) = log.inputs.read()
    (truth,) = log.truth.read()
    write_log(into, batch, log.channels, (inputs.t, inputs.values), (log.truth.names, truth.t, truth.values), ".csv")
    return into


def same(found, frame):
    """To rounding: a trace is another program."""
    for column in [c for c in frame.columns if "." in c]:
        size = np.abs(frame[column]).max()
        np.testing.assert_allclose(found[column], frame[column], rtol=0, atol=1e-14 * size, err_msg=column)


@pytest.mark.parametrize("kind", ["parquet", "csv"])
@pytest.mark.parametrize("name", ["plain", "wild", "stamped"])
def test_estimates_are_those_of_the_run(traced, name, kind, tmp_path):
    study, frame, folder = traced[name]
    log = folder if kind == "parquet" else as_csv(folder, tmp_path / "log")
    found = pcbench.replay(log, study, OBSERVERS).estimates
    assert list(found.columns) == ["t", "angle", "rate", *(c for c in frame.columns if "." in c)]
    assert "kf.rate.sigma" in found.columns
    np.testing.assert_allclose(found[["angle", "rate"]], frame[["angle", "rate"]], rtol=0, atol=1e-14)
    same(found, frame)


@pytest.mark.ci
def test_what_is_known_of_a_log_in_parts_is_what_is_known_of_the_whole(traced, monkeypatch):
    """To rounding: another length is another program. Of each observer, though each is computed by itself."""
    study, _, folder = traced["wild"]
    whole = pcbench.replay(folder, study, OBSERVERS)
    monkeypatch.setattr(setup, "LENGTH", 64)
    found = pcbench.replay(folder, study, OBSERVERS)
    assert set(found.metrics.observer) == set(OBSERVERS)
    for what in ("estimates", "innovations", "distances", "metrics"):
        pd.testing.assert_frame_equal(getattr(found, what), getattr(whole, what), rtol=1e-9, atol=1e-12)


@pytest.mark.ci
@pytest.mark.parametrize("size", [0.0, 1e12])
def test_a_state_too_large_for_the_digits_of_its_errors_is_said(size, tmp_path):
    """A position of 1e12 m is resolved to 0.1 mm; its noise is as large."""
    t, arrived = np.arange(40) * 0.05, np.arange(40) * 0.05 + 0.1
    batch = Batch(np.zeros(40, int), t, arrived, size + t, np.arange(40))
    k = np.arange(200) * 0.01
    write_log(tmp_path, batch, ("y1",), None, (("position", "velocity"), k, np.stack([size + k, np.ones(200)], 1)))
    lti = {
        "A": [[0.0, 1.0], [0.0, 0.0]],
        "states": ["position [m]", "velocity [m/s]"],
        "x0": [size, 1.0],
        "noise_std": 1e-4,
    }
    said = pcbench.replay(tmp_path, {**MOTOR, "lti": MOTOR["lti"] | lti}, ["kf"]).summary["notes"]
    lost = [sentence for sentence in said if "fewer than two digits" in sentence]
    assert len(lost) == (size > 0)
    assert all("kf" in sentence and "position" in sentence and "1e+12 m" in sentence for sentence in lost)


@pytest.mark.ci
def test_a_slip_of_one_tick_is_seen(traced, tmp_path):
    study, frame, folder = traced["plain"]
    log = tables.open_tables(folder)
    batch = Batch(*(np.concatenate(c) for c in zip(*log.measurements(), strict=True)))
    (inputs,) = log.inputs.read()
    write_log(tmp_path, batch._replace(arrived=batch.arrived + 0.01), log.channels, (inputs.t, inputs.values))
    found = pcbench.replay(tmp_path, study, OBSERVERS).estimates
    assert not np.array_equal(found["kf.angle"][: len(frame)], frame["kf.angle"][: len(found)])


@pytest.mark.nightly
def test_errors_against_truth_are_those_of_the_study(traced):
    study, _, folder = traced["plain"]
    found = pcbench.replay(folder, study, OBSERVERS).metrics.set_index(["observer", "signal", "metric"]).value
    run = pcbench.run(study, observers=OBSERVERS, seeds=1, first_seed=3).runs
    for row in run.to_dict("records"):
        for metric in (
            "mae",
            "rmse",
            "mse",
            "max_abs_error",
            "final_error",
            "settling_time",
            "steady_mae",
            "steady_rmse",
            "steady_max_abs_error",
        ):
            assert found[row["observer"], row["signal"], metric] == pytest.approx(row[metric], rel=1e-9, abs=1e-12), (
                metric
            )


def test_truth_at_some_ticks_is_scored_there(traced, tmp_path):
    study, frame, folder = traced["plain"]
    log = tables.open_tables(folder)
    batch = Batch(*(np.concatenate(c) for c in zip(*log.measurements(), strict=True)))
    (inputs,), (truth,) = log.inputs.read(), log.truth.read()
    some = slice(5, None, 7)
    known = log.truth.names, truth.t[some], truth.values[some]
    write_log(tmp_path, batch, log.channels, (inputs.t, inputs.values), known)
    found = pcbench.replay(tmp_path, study, OBSERVERS).metrics.set_index(["observer", "signal", "metric"]).value
    e = (frame["angle"] - frame["kf.angle"]).to_numpy()[: len(frame) - 1][some]
    assert found["kf", "angle", "mae"] == pytest.approx(np.abs(e).mean(), rel=1e-10)
    assert found["kf", "angle", "final_error"] == pytest.approx(e[-1], rel=1e-10)


def test_truth_of_some_states_at_some_ticks_is_scored_there(traced, tmp_path):
    study, frame, folder = traced["plain"]
    shutil.copytree(folder, tmp_path / "log")
    truth = pd.read_parquet(folder / "truth.parquet")
    truth.loc[truth.index % 3 > 0, "angle"] = np.nan
    truth.loc[truth.index % 5 > 0, "rate"] = np.nan
    for columns in (["t", "angle", "rate"], ["t", "rate"]):
        truth[columns].to_parquet(tmp_path / "log" / "truth.parquet", index=False)
        found = pcbench.replay(tmp_path / "log", study, OBSERVERS).metrics
        assert set(found.signal[found.metric == "mae"]) == set(columns[1:])
        values = found.set_index(["observer", "signal", "metric"]).value
        for name, every in (("angle", 3), ("rate", 5)):
            if name in columns:
                e = np.abs(frame[name] - frame[f"kf.{name}"]).to_numpy()[: len(frame) - 1][::every]
                assert values["kf", name, "mae"] == pytest.approx(e.mean(), rel=1e-10)
                assert values["kf", name, "max_abs_error"] == pytest.approx(e.max(), rel=1e-10)


def test_truth_is_read_by_the_names_of_its_columns(traced, tmp_path):
    study, _, folder = traced["plain"]
    shutil.copytree(folder, tmp_path / "log")
    truth = pd.read_parquet(folder / "truth.parquet")
    truth[truth.columns[::-1]].assign(more=0.0).to_parquet(tmp_path / "log" / "truth.parquet", index=False)
    here, there = (pcbench.replay(log, study, OBSERVERS).metrics for log in (tmp_path / "log", folder))
    pd.testing.assert_frame_equal(here, there, check_exact=True)


def test_what_never_arrived_stands_in_the_log_without_an_arrival(traced):
    _, frame, folder = traced["wild"]
    (batch,) = tables.open_tables(folder).measurements()
    lost = np.isnan(batch.arrived)
    assert 0 < lost.sum() < len(lost)
    assert (np.isnan(batch.value) <= lost).all()
    assert batch.arrived[~lost].max() <= frame.t.iloc[-1]


def test_a_log_is_the_run_whatever_precision_the_host_program_chose(traced, tmp_path):
    study, _, folder = traced["wild"]
    with jax.enable_x64(False):
        pcbench.simulate(study, OBSERVERS, seed=3, log=tmp_path)
    for name in ("measurements", "inputs", "truth"):
        there, here = (pd.read_parquet(each / f"{name}.parquet") for each in (folder, tmp_path))
        pd.testing.assert_frame_equal(there, here, check_exact=True)


def test_a_replay_that_is_refused_half_way_leaves_no_folder_but_one_that_was_there(traced, tmp_path):
    """Times of inputs that go back are seen while the log runs."""
    study, _, folder = traced["plain"]
    shutil.copytree(folder, tmp_path / "log")
    inputs = pd.read_parquet(tmp_path / "log" / "inputs.parquet")
    inputs.assign(t=inputs.t.where(inputs.index != 7, 0.0)).to_parquet(tmp_path / "log" / "inputs.parquet", index=False)
    (tmp_path / "there").mkdir()
    for out in ("new", "there"):
        with pytest.raises(UserError, match=r"inputs\.parquet: row 8: got the time 0 s after"):
            pcbench.replay(tmp_path / "log", study, OBSERVERS, out=tmp_path / out)
    assert not list((tmp_path / "there").iterdir())
    assert not (tmp_path / "new").exists()


def test_a_folder_has_estimates_with_units_and_what_is_known(traced, tmp_path):
    import pyarrow.parquet as pq

    study, frame, folder = traced["plain"]
    found = pcbench.replay(folder, study, OBSERVERS, out=tmp_path / "out")
    assert found.estimates is None
    table = pq.read_table(tmp_path / "out" / "estimates.parquet")
    assert len(table) == len(frame)
    assert table.schema.field("kf.rate").metadata[b"unit"] == b"rad/s"
    assert (tmp_path / "out" / "replay.json").is_file()
    files = ["estimates.parquet", "innovations.parquet", "replay.json", "smoothed.parquet"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == files
    assert found.summary["largest_rounding"] < 1e-12
    assert found.summary["better_dt"] is None
