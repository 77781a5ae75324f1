"""What is in a file of any format is listed without a TOML, and the TOML that is written to start from works as it is."""

import json
import re

import numpy as np
import pandas as pd
import pytest
import recorded
import tomli_w
from commands import call
from logged import MOTOR

import pcbench
from pcbench.errors import UserError
from pcbench.recordings import contents, readers
from pcbench.recordings.survey import survey

T = np.arange(0, 4, 0.05)
RUN = recorded.Run(T, T + 0.1, np.sin(T), T, np.cos(T))


def raw(folder, write):
    """A file as a recorder writes it, without its TOML."""
    write(folder, RUN).unlink()
    return next(folder.glob("run*"))


def fields(path):
    return {(row["topic"], row["field"]): row for row in contents.rows_of(contents.contents(path))}


@pytest.mark.parametrize("write", recorded.FORMATS.values(), ids=recorded.FORMATS)
def test_contents_have_topics_counts_rates_and_ranges(write, tmp_path):
    found = fields(raw(tmp_path, write))
    (key,) = (key for key in found if key[0].strip("/") in ("camera", "angle") and key[1] in ("point.x", "x"))
    row = found[key]
    assert (row["rows"], row["missing"], row["constant"]) == (80, 0, False)
    assert row["rate"] == pytest.approx(20, rel=1e-6)
    assert (row["least"], row["most"]) == (np.sin(T).min(), np.sin(T).max())
    assert row["last"] - row["first"] == pytest.approx(T[-1], abs=1e-6)


@pytest.mark.parametrize("write", recorded.FORMATS.values(), ids=recorded.FORMATS)
def test_starter_toml_is_a_log_of_the_same_numbers(write, tmp_path):
    path = raw(tmp_path, write)
    text = contents.starter_toml(path, contents.contents(path), tmp_path)
    (tmp_path / "start.toml").write_text(text)
    log = readers.open_log(tmp_path / "start.toml")
    first = next(iter(log.measurements()))
    np.testing.assert_array_equal(first.value, np.sin(T))
    (inputs,) = log.inputs.read()
    np.testing.assert_array_equal(inputs.values[:, 0], np.cos(T))
    assert survey(log).start == pytest.approx(0.0, abs=1e-9)


@pytest.mark.ci
@pytest.mark.parametrize("name", ["bag of ROS 2", "flight log", "MATLAB"])
def test_three_commands_are_from_a_file_to_a_replay(tmp_path, name):
    file = raw(tmp_path, recorded.FORMATS[name]).name
    (tmp_path / "motor.toml").write_text(tomli_w.dumps(MOTOR))
    for words in (["info", file], ["info", file, "--toml", "--out", "start.toml"]):
        done = call(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    assert ", 80 rows, 3.95 s from 0 s" in call("info", file, cwd=tmp_path).stdout
    again = call("info", file, "--toml", "--out", "start.toml", cwd=tmp_path)
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    words = ["replay", "start.toml", "--plant", "motor.toml", "--observers", "kf", "--out", "out"]
    done = call(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_info_counts_missing_constant_and_repeated_values(tmp_path):
    y = np.sin(T)
    y[::2] = np.nan
    table = {"t [ms]": 1e3 * T, "y [µm]": y, "dead": 3.5, "held": np.repeat(T[::4], 4), "note": "calm", "u": 0.5}
    pd.DataFrame(table).to_csv(tmp_path / "run.csv", index=False)
    found = fields(tmp_path / "run.csv")
    assert set(found) == {("", name) for name in table if name != "note"}
    assert (found["", "y [µm]"]["missing"], found["", "y [µm]"]["rate"]) == (40, pytest.approx(39 / T[-1]))
    assert found["", "dead"]["constant"]
    assert found["", "held"]["repeats"] == 60
    text = contents.starter_toml(tmp_path / "run.csv", contents.contents(tmp_path / "run.csv"), tmp_path)
    assert 'unit = "µm"' in text
    assert '# field = "dead"' in text
    assert re.search(r"^\[inputs.u1\]  # 0.5 to 0.5$", text, re.MULTILINE)
    (tmp_path / "start.toml").write_text(text)
    assert survey(readers.open_log(tmp_path / "start.toml")).channels["y1"].stamps.many == 40


@pytest.mark.parametrize(("scale", "unit"), [(1e9, "ns"), (1e6, "us"), (1e3, "ms"), (1.0, None)])
def test_starter_toml_has_the_unit_of_stamps_by_their_size(tmp_path, scale, unit):
    stamps = ((1_772_366_400 + T) * scale).astype("int64" if unit else float)
    pd.DataFrame({"time": stamps, "y": np.sin(T)}).to_csv(tmp_path / "run.csv", index=False)
    text = contents.starter_toml(tmp_path / "run.csv", contents.contents(tmp_path / "run.csv"), tmp_path)
    assert (f'time_unit = "{unit}"' in text) == (unit is not None)
    (tmp_path / "start.toml").write_text(text)
    assert survey(readers.open_log(tmp_path / "start.toml")).start == pytest.approx(1_772_366_400)


def test_starter_toml_takes_a_column_of_arrivals_from_its_name(tmp_path):
    pd.DataFrame({"t_taken": T, "t_arrived": T + 0.15, "angle": np.sin(T)}).to_csv(tmp_path / "run.csv", index=False)
    text = contents.starter_toml(tmp_path / "run.csv", contents.contents(tmp_path / "run.csv"), tmp_path)
    (tmp_path / "start.toml").write_text(text)
    row = pcbench.info(tmp_path / "start.toml").iloc[0]
    assert (row.channel, row.samples, row.delay_median) == ("y1", 80, pytest.approx(0.15))
    assert "delay =" not in text


def test_folder_of_unrelated_tables_names_what_it_lacks(tmp_path):
    pd.DataFrame({"t": T, "gyro": np.sin(T)}).to_csv(tmp_path / "imu.csv", index=False)
    with pytest.raises(UserError, match="has neither a table measurements"):
        contents.contents(tmp_path)


def test_list_of_files_is_refused_with_the_page_that_combines_them(tmp_path):
    (tmp_path / "both.toml").write_text('log = ["imu.csv", "camera.csv"]\n[channels.y1]\nfield = "angle"\nunit = "rad"')
    with pytest.raises(UserError, match=r"log is the name of one file .* pcbench guide recording-files"):
        readers.open_log(tmp_path / "both.toml")


def test_columns_of_structs_and_times_by_type_are_fields(tmp_path):
    stamps = pd.to_datetime(1_772_366_400 + T, unit="s")
    poses = [{"position": {"x": x, "y": 0.0}} for x in np.sin(T)]
    pd.DataFrame({"when": stamps, "pose": poses}).to_parquet(tmp_path / "run.parquet")
    found = fields(tmp_path / "run.parquet")
    assert set(found) == {("", "pose.position.x"), ("", "pose.position.y")}
    assert found["", "pose.position.x"]["first"] == pytest.approx(1_772_366_400)


def test_frames_of_transforms_are_listed_and_one_is_a_channel(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/tf", "json", writer.register_schema("tf", "jsonschema", b"{}"))
        for i, t in enumerate(T):
            transforms = [
                {"header": {"stamp": {"sec": int(t), "nsec": round(t % 1 * 1e9)}}, "child_frame_id": name, "x": i + k}
                for k, name in enumerate(("base", "camera"))
            ]
            message = {"transforms": transforms[: 1 + i % 2]}  # the camera in every second message
            writer.add_message(channel, round(1e9 * t), json.dumps(message).encode(), round(1e9 * t))
        writer.finish()
    every = contents.rows_of(contents.contents(tmp_path / "run.mcap"))
    assert [(row["frame"], row["rows"]) for row in every] == [("base", 80), ("camera", 40)]
    text = 'log = "run.mcap"\n[channels.y1]\ntopic = "/tf"\nframe = "camera"\nfield = "x"\nunit = "m"'
    (tmp_path / "log.toml").write_text(text)
    (batch,) = readers.open_log(tmp_path / "log.toml").measurements()
    np.testing.assert_array_equal(batch.value, np.arange(1, 80, 2) + 1)
    (tmp_path / "log.toml").write_text(text.replace("camera", "camra"))
    with pytest.raises(UserError, match="'camra' is no child frame; did you mean 'camera'"):
        survey(readers.open_log(tmp_path / "log.toml"))


@pytest.mark.parametrize(
    "name", ["run.bag", "run.mcap", "run.ulg", "run.mat", "run.csv", "run.parquet", "run.db3", "run.xyz", "run"]
)
@pytest.mark.parametrize("content", [b"", b"not a recording" * 40, None])
def test_what_is_no_recording_is_one_sentence(tmp_path, name, content):
    path = tmp_path / name
    path.mkdir() if content is None else path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        contents.contents(path) if not contents.is_log(path) else pcbench.info(path)
    assert name in str(caught.value)
    assert str(caught.value).count(". ") == 0
    assert len(str(caught.value)) < 400
