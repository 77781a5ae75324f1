"""What was not measured is no measurement; inputs and truth are of several topics, of structs, of messages without stamps."""

import json

import numpy as np
import pandas as pd
import pytest
import scipy.io
from logged import MOTOR, plain, rows

import pcbench
from pcbench.errors import UserError
from pcbench.recordings import readers
from pcbench.recordings.inputs_and_truth import merge
from pcbench.recordings.log import Rows, Table
from pcbench.recordings.survey import survey

T = np.arange(0, 2, 0.05)
CHANNEL = '[channels.y{0}]\nfield = "y{0}"\nunit = "m"\n{{more}}\n'
MAPPED = 'log = "{name}"\n{keys}\n' + CHANNEL.format(1) + CHANNEL.format(2)


def open_wide_log(folder, name, keys="", more="delay = 0.0"):
    (folder / "log.toml").write_text(MAPPED.format(name=name, keys=keys, more=more))
    return readers.open_log(folder / "log.toml")


def slow():
    """A fast channel, and one that has a value in every fourth row."""
    return pd.DataFrame({"t": T, "y1": np.sin(T), "y2": np.where(np.arange(len(T)) % 4, np.nan, np.cos(T))})


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat", "json"])
def test_row_without_a_value_is_no_measurement(tmp_path, kind):
    table, keys, more = slow(), "", "delay = 0.0"
    if kind == "csv":
        table.to_csv(tmp_path / "run.csv", index=False)
    elif kind == "parquet":
        table.to_parquet(tmp_path / "run.parquet", index=False)
    elif kind == "mat":
        scipy.io.savemat(tmp_path / "run.mat", dict(table))
    else:
        kind, more = "mcap", 'topic = "/all"\nsampled = "received"'
        mcap(tmp_path, {"/all": (T, table.replace({np.nan: None}).to_dict("records"))})
    found = survey(open_wide_log(tmp_path, f"run.{kind}", keys, more)).channels
    assert [c.stamps.many for c in found.values()] == [40, 10]
    assert found["y2"].intervals.median == pytest.approx(0.2, abs=1e-9)


def mcap(folder, topics):
    """Messages (times, messages) as JSON by topic, without headers."""
    from mcap.writer import Writer

    with (folder / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("row", "jsonschema", b"{}")
        for topic, (times, messages) in topics.items():
            channel = writer.register_channel(topic, "json", schema)
            for t, message in zip(times, messages, strict=False):
                writer.add_message(channel, round(1e9 * t), json.dumps(message).encode(), round(1e9 * t))
        writer.finish()


def test_value_without_a_stamp_is_refused_and_a_row_without_both_is_none(tmp_path):
    table = slow().assign(t2=lambda frame: frame.t.where(~frame.y2.isna()))
    table.to_csv(tmp_path / "run.csv", index=False)
    text = MAPPED.format(name="run.csv", keys="", more="delay = 0.0") + 'sampled = "t2"'
    (tmp_path / "log.toml").write_text(text)
    assert survey(readers.open_log(tmp_path / "log.toml")).channels["y2"].stamps.many == 10
    table.assign(t2=np.nan).to_csv(tmp_path / "run.csv", index=False)
    with pytest.raises(UserError, match="row 1 of channel y2: got a sample without a time"):
        survey(readers.open_log(tmp_path / "log.toml"))


def test_measurement_without_a_value_is_none_unless_it_was_lost(tmp_path):
    columns = {name: list(values) for name, values in plain().items()}
    columns["value"][3] = columns["value"][5] = columns["arrived"][5] = np.nan
    (row,) = pcbench.info(rows(tmp_path / "log", columns)).to_dict("records")
    assert (row["samples"], row["lost"]) == (39, 1)


def test_inputs_and_truth_of_several_topics_are_held_and_unknown(tmp_path):
    u, v, x = (
        [{"a": float(i)} for i in range(40)],
        [{"b": 10.0 + i} for i in range(10)],
        [{"x": float(i)} for i in range(5)],
    )
    y, late = [{"y": 0.0}] * 40, 8 * T + 0.01
    mcap(tmp_path, {"/y": (T, y), "/u": (T, u), "/v": (0.3 + 4 * T, v), "/x": (8 * T, x), "/w": (late, x)})
    (tmp_path / "log.toml").write_text(
        'log = "run.mcap"\n[channels.y1]\ntopic = "/y"\nfield = "y"\nunit = "m"\nsampled = "received"\n'
        '[inputs.u1]\ntopic = "/v"\nfield = "b"\nunit = "V"\n[inputs.u2]\ntopic = "/u"\nfield = "a"\nunit = "V"\n'
        '[truth.p]\ntopic = "/x"\nfield = "x"\nunit = "m"\n[truth.q]\ntopic = "/w"\nfield = "x"\nunit = "m"\n'
    )
    log = readers.open_log(tmp_path / "log.toml")
    inputs, truth = (np.concatenate([r.values for r in table.read()]) for table in (log.inputs, log.truth))
    times = np.concatenate([r.t for r in log.inputs.read()])
    for t, (first, second) in zip(times, inputs, strict=True):  # each by itself: the newest row at or before t
        assert first == (0.0 if t < 0.3 - 1e-9 else 10.0 + np.floor(min((t - 0.3) / 0.2, 9) + 1e-6))
        assert second == np.floor(min(t / 0.05, 39) + 1e-6)
    np.testing.assert_array_equal(truth[::2, 0], np.arange(5))
    np.testing.assert_array_equal(truth[1::2, 1], np.arange(5))
    assert np.isnan(truth[::2, 1]).all()
    assert np.isnan(truth[1::2, 0]).all()


@pytest.mark.parametrize("parts", [(1, 1), (3, 7), (50, 2)])
def test_tables_are_merged_in_the_order_of_their_times_however_they_are_cut(parts):
    rng = np.random.default_rng(4)
    times = [np.unique(rng.integers(0, 60, 30)) / 4 for _ in range(2)]
    tables = []
    for name, t, many in zip("ab", times, parts, strict=True):
        cuts = [
            Rows(t[i : i + many], t[i : i + many, None], np.arange(len(t))[i : i + many])
            for i in range(0, len(t), many)
        ]
        tables.append(Table((name,), lambda cuts=cuts: iter(cuts)))
    for hold in (True, False):
        found = list(merge(tables, ["b", "a"], hold).read())
        t, values = (np.concatenate([getattr(rows, what) for rows in found]) for what in ("t", "values"))
        np.testing.assert_array_equal(t, np.union1d(*times))
        for column, mine in zip(values.T, times[::-1], strict=True):
            newest = [mine[mine <= each].max(initial=0.0) for each in t]
            np.testing.assert_array_equal(column, newest if hold else np.where(np.isin(t, mine), t, np.nan))


def test_message_without_a_stamp_needs_received_for_a_channel_alone(tmp_path):
    mcap(tmp_path, {"/y": (T, [{"y1": 1.0}] * 40), "/u": (T, [{"data": 2.0}] * 40)})
    text = 'log = "run.mcap"\n[channels.y1]\ntopic = "/y"\nfield = "y1"\nunit = "m"\n'
    inputs = '[inputs.u1]\ntopic = "/u"\nfield = "data"\nunit = "V"\n'
    (tmp_path / "log.toml").write_text(text + inputs)
    with pytest.raises(UserError, match='or sampled = "received" if it has no stamp'):
        survey(readers.open_log(tmp_path / "log.toml"))
    (tmp_path / "log.toml").write_text(text + 'sampled = "received"\n' + inputs)
    log = readers.open_log(tmp_path / "log.toml")
    np.testing.assert_allclose(next(log.inputs.read()).t, T)
    (tmp_path / "log.toml").write_text(text + 'sampled = "received"\n' + inputs + 'sampled = "received"\n')
    with pytest.raises(
        UserError, match=r"inputs\.u1: got sampled, expected it of channels alone; name the column of the times by t"
    ):
        readers.open_log(tmp_path / "log.toml")


def test_frames_in_memory_are_a_recording(tmp_path):
    frames = {"measurements": pd.DataFrame(plain()), "inputs": pd.DataFrame({"t": [0.0, 1.0], "u1": [0.5, np.nan]})}
    folder = rows(tmp_path / "log", plain(), frames["inputs"])
    here, there = (pcbench.replay(log, MOTOR, "kf") for log in (frames, folder))
    pd.testing.assert_frame_equal(here.estimates, there.estimates, check_exact=True)
    assert pcbench.info(frames).samples.tolist() == [40]
    for wrong, sentence in (
        ({"measurement": frames["measurements"]}, "'measurement' is no table; did you mean 'measurements'"),
        ({"inputs": frames["inputs"]}, "got no frame 'measurements'"),
        ({"measurements": frames["measurements"].assign(value=[[1.0]] * 40)}, "measurements: value: got list"),
        ({"measurements": frames["measurements"].assign(value=[1, "a"] * 20)}, "measurements: "),
    ):
        with pytest.raises(UserError, match=sentence):
            pcbench.info(wrong)


def newer(path):
    """As MATLAB writes format 7.3: matrices with their dimensions reversed, structs as groups."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        file["dat"], file["y"] = np.stack([T, np.cos(T), np.sin(T)]), np.sin(T)[None]
        group = file.create_group("simout")
        group["time"] = T[None]
        group.create_group("signals")["values"] = np.sin(T)[None]
        file["secret"] = h5py.ExternalLink("/etc/hostname", "/")
        file["name"] = np.frombuffer("text".encode("utf-16-le"), np.uint16)[:, None]
        file["name"].attrs["MATLAB_class"] = np.bytes_("char")


def older(path):
    columns = np.stack([T, np.cos(T), np.sin(T)], 1)
    simout = {"time": T[:, None], "signals": {"values": np.sin(T)[:, None], "label": "y"}, "blockName": "m"}
    several = {"time": T, "signals": [{"values": np.cos(T)}, {"values": columns}]}
    scipy.io.savemat(path, {"dat": columns, "rows": columns.T, "y": np.sin(T), "simout": simout, "scope": several})


@pytest.mark.parametrize(
    ("write", "keys"),
    [
        (older, 'field = "dat.2"\nsampled = "dat.0"'),
        (older, 'field = "rows.2"\nsampled = "rows.0"'),
        (older, 'field = "y"\nperiod = 0.05'),
        (older, 'topic = "simout"\nfield = "signals.values"\nsampled = "time"'),
        (older, 'topic = "scope"\nfield = "signals.1.values.2"\nsampled = "time"'),
        (newer, 'field = "dat.2"\nsampled = "dat.0"'),
        (newer, 'topic = "simout"\nfield = "signals.values"\nsampled = "time"'),
    ],
)
def test_matrices_structs_and_periods_of_matlab_are_channels(tmp_path, write, keys):
    write(tmp_path / "run.mat")
    (tmp_path / "log.toml").write_text(f'log = "run.mat"\n[channels.y1]\n{keys}\nunit = "m"\ndelay = 0.0')
    (batch,) = readers.open_log(tmp_path / "log.toml").measurements()
    np.testing.assert_allclose(batch.sampled, T, atol=1e-12)
    np.testing.assert_array_equal(batch.value, np.sin(T))


@pytest.mark.parametrize(
    ("field", "sentence"),
    [("secret", "'secret' is no variable"), ("name", "got text"), ("dat.7", "'7' is no variable")],
)
def test_what_is_no_vector_in_format_7_3_is_one_sentence(tmp_path, field, sentence):
    newer(tmp_path / "run.mat")
    (tmp_path / "log.toml").write_text(
        f'log = "run.mat"\n[channels.y1]\nfield = "{field}"\nperiod = 0.05\nunit = "m"\ndelay = 0.0'
    )
    with pytest.raises(UserError, match=sentence):
        survey(readers.open_log(tmp_path / "log.toml"))


def test_period_is_of_the_file_or_of_one_channel(tmp_path):
    pd.DataFrame({"y1": T, "y2": T, "t": 0.1 + T}).to_csv(tmp_path / "run.csv", index=False)
    text = MAPPED.format(name="run.csv", keys="period = 0.5", more="delay = 0.0")
    (tmp_path / "log.toml").write_text(text + '\nperiod = 0.25\n[inputs.u1]\nfield = "y1"\nunit = "V"\nt = "t"')
    log = readers.open_log(tmp_path / "log.toml")
    for batch, period in zip(log.measurements(), (0.5, 0.25), strict=True):
        np.testing.assert_array_equal(batch.sampled, period * np.arange(40))
    np.testing.assert_allclose(next(log.inputs.read()).t, 0.1 + T)
    (tmp_path / "log.toml").write_text(text + '\nperiod = 0.25\nsampled = "t"')
    with pytest.raises(UserError, match="got a field of times and a period"):
        readers.open_log(tmp_path / "log.toml")
