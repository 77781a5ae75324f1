"""What a TOML corrects of a recording, in tables and in files whose fields it maps: stamps, units, an origin, held values."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tomli_w
from logged import MOTOR, plain, rows

import pcbench
from pcbench.errors import UserError
from pcbench.recordings import readers, tables
from pcbench.recordings.corrections import Changes, toml_with_offsets
from pcbench.recordings.log import Batch
from pcbench.recordings.survey import describe_held, survey


def read(log):
    """All samples of a recording."""
    return Batch(*(np.concatenate(column) for column in zip(*log.measurements(), strict=True)))


@pytest.fixture
def flight(tmp_path):
    """Tables with two channels, inputs and truth."""
    columns = plain()
    second = {"channel": ["y2"] * 40, "sampled": columns["sampled"], "arrived": columns["arrived"] + 0.1}
    both = {name: [*columns[name], *each] for name, each in (second | {"value": np.repeat(np.arange(10.0), 4)}).items()}
    t = np.arange(3) * 1.0
    rows(tmp_path / "flight", both, {"t": t, "u1": [1.0, 2.0, 3.0]})
    pd.DataFrame({"t": t, "angle": [5.0, 6.0, 7.0]}).to_csv(tmp_path / "flight" / "truth.csv", index=False)
    return tmp_path


def write_toml(folder, **toml):
    (folder / "log.toml").write_text(tomli_w.dumps({"log": "flight"} | toml))
    return folder / "log.toml"


def test_tables_are_corrected_by_channel(flight):
    channels = {"y1": {"clock_offset": -0.02, "scale": 2.0, "offset": 3.0}, "y2": {"only_changes": True}}
    toml = write_toml(flight, channels=channels, inputs={"u1": {"scale": -1.0}}, truth={"angle": {"offset": 10.0}})
    log, bare = readers.open_log(toml), readers.open_log(flight / "flight")
    before, after = read(bare), read(log)
    one, mine = before.channel == 0, after.channel == 0
    np.testing.assert_allclose(after.sampled[mine], before.sampled[one] - 0.02)
    np.testing.assert_array_equal(after.arrived[mine], before.arrived[one])
    np.testing.assert_allclose(after.value[mine], 2.0 * before.value[one] + 3.0)
    np.testing.assert_array_equal(after.value[~mine], np.arange(10.0))
    np.testing.assert_array_equal(after.row[~mine], 41 + 4 * np.arange(10))
    assert next(log.inputs.read()).values[:, 0].tolist() == [-1.0, -2.0, -3.0]
    assert next(log.truth.read()).values[:, 0].tolist() == [15.0, 16.0, 17.0]


def test_changes_are_seen_across_parts():
    changes = Changes()
    assert changes(np.array([1.0, 1.0, 2.0])).tolist() == [True, False, True]
    assert changes(np.array([])).tolist() == []
    assert changes(np.array([2.0, 1.0])).tolist() == [False, True]


def test_standard_deviations_are_scaled(flight):
    path = flight / "flight" / "measurements.csv"
    pd.read_csv(path).assign(std=0.1).to_csv(path, index=False)
    assert set(read(readers.open_log(write_toml(flight, channels={"y1": {"scale": -3.0}}))).std.round(9)) == {0.1, 0.3}


def test_delays_of_tables_without_arrivals_count_from_the_corrected_stamp(flight):
    path = flight / "flight" / "measurements.csv"
    pd.read_csv(path).drop(columns="arrived").to_csv(path, index=False)
    toml = write_toml(flight, channels={"y1": {"clock_offset": -1.0, "delay": 0.25}, "y2": {"delay": 0.0}})
    got = read(readers.open_log(toml))
    np.testing.assert_allclose((got.arrived - got.sampled)[got.channel == 0], 0.25)
    np.testing.assert_allclose((got.arrived - got.sampled)[got.channel == 1], 0.0)
    toml = write_toml(flight, channels={"y1": {"delay": 0.25}})
    np.testing.assert_allclose(
        (lambda b: (b.arrived - b.sampled)[b.channel == 1])(read(readers.open_log(toml, 0.1))), 0.1
    )
    with pytest.raises(UserError, match=r"channels.y2: got no delay and a table without arrivals"):
        readers.open_log(toml)


@pytest.mark.parametrize(
    ("toml", "sentence"),
    [
        ({"channels": {"y3": {"scale": 2.0}}}, "log.toml: channels: 'y3' is no name"),
        ({"channels": {"y1": {"delay": 0.1}}}, "channels.y1: got a delay and a table with arrivals"),
        ({"channels": {"y1": {"clock_offset": "late"}}}, "channels.y1.clock_offset: input should be a valid number"),
        ({"inputs": {"u1": {"clock_offset": 0.1}}}, "inputs.u1: 'clock_offset' is no key"),
        ({"channels": {}, "truth": {"rate": {}}}, "truth: 'rate' is no name"),
    ],
)
def test_what_tables_do_not_have_is_one_sentence(flight, toml, sentence):
    with pytest.raises(UserError, match=sentence):
        readers.open_log(write_toml(flight, **toml))


def write_wide_log(folder, **more):
    """A wide file whose fields a TOML maps."""
    t = np.arange(6) * 0.1
    pd.DataFrame({"t": t, "level": [4.5, 4.5, 4.6, np.nan, 4.6, 4.7], "u": 1.0}).to_csv(
        folder / "wide.csv", index=False
    )
    channel = {"field": "level", "unit": "m", "delay": 0.0}
    inputs = {"u1": {"field": "u", "unit": "V", "offset": -1.0}}
    toml = {"log": "wide.csv", "channels": {"y1": channel | more}, "inputs": inputs}
    (folder / "wide.toml").write_text(tomli_w.dumps(toml))
    return folder / "wide.toml"


def test_fields_are_corrected_too(tmp_path):
    log = readers.open_log(
        write_wide_log(tmp_path, scale=10.0, offset=-40.0, clock_offset=0.5, only_changes=True, delay=0.2)
    )
    got = read(log)
    np.testing.assert_allclose(got.value, [5.0, 6.0, 7.0])
    np.testing.assert_allclose(got.sampled, [0.5, 0.7, 1.0])
    np.testing.assert_allclose(got.arrived - got.sampled, 0.2)
    assert got.row.tolist() == [1, 3, 6]
    assert next(log.inputs.read()).values[:, 0].tolist() == [0.0] * 6


def test_clock_offset_of_an_input_is_refused(tmp_path):
    toml = write_wide_log(tmp_path)
    toml.write_text(toml.read_text() + "clock_offset = 0.1\n")
    with pytest.raises(UserError, match=r"inputs.u1: got clock_offset, expected it of channels alone"):
        readers.open_log(toml)


@pytest.mark.parametrize("delay", [None, 0.1])
def test_offsets_are_written_so_that_arrivals_stay(tmp_path, delay):
    (tmp_path / "out").mkdir()
    source = write_wide_log(tmp_path, delay=0.05, clock_offset=1.0)
    text = toml_with_offsets(source, {"y1": -0.3}, delay, tmp_path / "out")
    (tmp_path / "out" / "recording.toml").write_text(text)
    assert tomllib.loads(text)["log"] == "../wide.csv"
    before, after = read(readers.open_log(source)), read(readers.open_log(tmp_path / "out" / "recording.toml"))
    np.testing.assert_allclose(after.sampled, before.sampled - 0.3)
    np.testing.assert_allclose(after.arrived, before.arrived)


def test_offsets_of_tables_are_a_toml_that_names_them(flight, monkeypatch):
    monkeypatch.chdir(flight)
    Path("out").mkdir()
    Path("out/recording.toml").write_text(toml_with_offsets(Path("flight"), {"y2": 0.05}, None, Path("out")))
    assert Path("out/recording.toml").read_text() == 'log = "../flight"\n\n[channels.y2]\nclock_offset = 0.05\n'
    before, after = read(readers.open_log("flight")), read(readers.open_log("out/recording.toml"))
    np.testing.assert_allclose(after.sampled - before.sampled, 0.05 * after.channel)
    assert not tables.has_channels(Path("out/recording.toml"))


def test_constant_and_held_values_are_counted(flight):
    columns = plain()
    rows(flight / "constant", columns | {"value": np.ones(40)})
    assert describe_held(survey(readers.open_log(flight / "constant"))) == ["y1 never changes: all of 40 values are 1."]
    (said,) = describe_held(survey(readers.open_log(flight / "flight")))
    assert said.startswith("y2: 30 of 40 values repeat the one before")
    table = pcbench.info(flight / "flight").set_index("channel")
    assert table.repeated.tolist() == [0, 30]
    assert table.constant.tolist() == [False, False]
    assert table.most["y2"] == 9.0


@pytest.mark.ci
def test_absolute_values_are_warned_of_and_an_offset_corrects_them(tmp_path):
    pcbench.simulate(MOTOR, "kf", seed=2, log=tmp_path / "flight")
    path = tmp_path / "flight" / "measurements.parquet"
    moved = pd.read_parquet(path)
    moved["value"] += 20.0
    moved.to_parquet(path)
    toml = write_toml(tmp_path, channels={"y1": {"offset": -20.0}})
    wrong, right = (pcbench.replay(log, MOTOR, "kf").summary["notes"] for log in (tmp_path / "flight", toml))
    assert any("above the predictions of kf on average: if its values are absolute" in sentence for sentence in wrong)
    assert not any("absolute" in sentence for sentence in right)
