"""A run as a bag, an MCAP file, a flight log or a MATLAB file is the run again: its estimates, to rounding."""

import numpy as np
import pytest
import pyulog
import recorded
import scipy.io
import scipy.sparse
from logged import MOTOR, rows

import pcbench
from pcbench.errors import UserError
from pcbench.recordings import readers, tables
from pcbench.recordings.survey import survey

OBSERVERS = ["pccebo", "kf"]
WILD = MOTOR | {"lti": MOTOR["lti"] | {"delay_jitter": 0.15, "loss": 0.2, "sampling_jitter": 0.02}}


def simulate_log(study, folder):
    """A run of a study: its frame, the folder of its log, and what arrived."""
    frame = pcbench.simulate(study, OBSERVERS, seed=3, log=folder)
    log = tables.open_tables(folder)
    (batch,), (inputs,) = log.measurements(), log.inputs.read()
    came = ~np.isnan(batch.arrived)
    there = (column[came] for column in (batch.sampled, batch.arrived, batch.value))
    return frame, folder, recorded.Run(*there, inputs.t, inputs.values[:, 0])


def same(found, tabled, frame):
    """To the bit those of the same log in tables, to rounding the run's, for a trace is another program.

    Over all ticks of both: a sample that never came is in no recording, so one may end before the other.
    """
    many = min(len(found), len(tabled), len(frame))
    assert many > 380
    for column in found.columns[1:]:
        np.testing.assert_array_equal(found[column][:many], tabled[column][:many], err_msg=column)
        if column.endswith(".sigma"):  # traces have none without consistency
            continue
        peak = np.abs(frame[column]).max()
        np.testing.assert_allclose(tabled[column][:many], frame[column][:many], rtol=0, atol=1e-14 * peak)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return simulate_log(MOTOR, tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def wild(tmp_path_factory):
    """Late, lost and out of sequence."""
    return simulate_log(WILD, tmp_path_factory.mktemp("wild"))


@pytest.mark.parametrize("name", ["plain", pytest.param("wild", marks=pytest.mark.nightly)])
@pytest.mark.parametrize("write", recorded.FORMATS.values(), ids=recorded.FORMATS)
def test_a_recording_is_its_tables_again_and_these_the_run(name, request, write, tmp_path):
    frame, folder, known = request.getfixturevalue(name)
    study = MOTOR if name == "plain" else WILD
    found, tabled = (pcbench.replay(log, study, OBSERVERS).estimates for log in (write(tmp_path, known), folder))
    same(found, tabled, frame)


@pytest.mark.parametrize("write", recorded.FORMATS.values(), ids=recorded.FORMATS)
def test_a_topic_or_a_field_that_is_not_there_is_one_sentence(plain, write, tmp_path):
    path = write(tmp_path, plain[2])
    text = path.read_text()
    for old, new in (
        ("camera", "radar"),
        ("angle", "radar"),
        ('field = "point.x"', 'field = "point.w"'),
        ('"x"', '"w"'),
    ):
        if old in text:
            path.write_text(text.replace(old, new))
            with pytest.raises(UserError, match=r"radar|'w'") as caught:
                survey(readers.open_log(path))
            assert str(caught.value).startswith("log.toml: "), caught.value
            assert str(caught.value).count(". ") == 0


@pytest.mark.parametrize("write", recorded.FORMATS.values(), ids=recorded.FORMATS)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.97])
def test_a_recording_that_is_cut_off_is_one_sentence(plain, write, share, tmp_path):
    """But for flight logs: one that is cut off ends earlier, as that of every flight does whose power went."""
    path = write(tmp_path, plain[2])
    file = next(p for p in tmp_path.rglob("run.*") if p.is_file())
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    if file.suffix == ".ulg" and share:
        assert 0 < survey(readers.open_log(path)).rows < len(plain[2].t)
        return
    with pytest.raises(UserError, match="; expected a complete") as caught:
        survey(readers.open_log(path))
    assert str(caught.value).startswith("log.toml: run")
    assert ": ;" not in str(caught.value)


def test_a_flight_log_is_loaded_once_and_of_its_topics_those_that_are_asked_for(plain, tmp_path, monkeypatch):
    path, asked, loads = recorded.ulog(tmp_path, plain[2]), [], pyulog.ULog
    path.write_text(
        path.read_text().replace("[inputs.u1]", "[channels.y2]").replace("motor", "angle")
    )  # one topic, twice
    monkeypatch.setattr(pyulog, "ULog", lambda *given: asked.append(given[1]) or loads(*given))
    log = readers.open_log(path)
    for _ in range(2):
        assert survey(log).rows == 2 * len(plain[2].sampled)
    assert asked == [["angle"]]


def test_a_matlab_file_is_loaded_once_and_of_its_variables_those_that_are_asked_for(plain, tmp_path, monkeypatch):
    path, asked, loads = recorded.matlab(tmp_path, plain[2]), [], scipy.io.loadmat
    path.write_text(
        path.read_text().replace("[inputs.u1]", "[channels.y2]").replace("motor", "camera") + '\narrived = "came"'
    )
    monkeypatch.setattr(
        scipy.io, "loadmat", lambda file, **how: asked.append(how.get("variable_names")) or loads(file, **how)
    )
    log = readers.open_log(path)
    for _ in range(2):
        assert survey(log).rows == 2 * len(plain[2].sampled)
    assert asked == [["camera"]]


@pytest.mark.parametrize(
    ("value", "got"),
    [
        ("much", "got text"),
        (np.array(["much"] * 3), "got text"),
        (np.arange(3) + 1j, "got complex numbers"),
        ({"a": 1.0}, "got a struct"),
        (np.array([1.0, "much", [1, 2]], object), "got a struct, cells"),
        (scipy.sparse.csc_matrix(np.ones((3, 1))), "what is sparse"),
        (np.ones((3, 2)), "got x (3, 2), t (3,)"),
    ],
)
def test_what_is_no_vector_of_numbers_in_a_matlab_file_is_one_sentence(tmp_path, value, got):
    scipy.io.savemat(tmp_path / "run.mat", {"t": np.arange(3.0), "x": value})
    (tmp_path / "log.toml").write_text('log = "run.mat"\n[channels.y1]\nfield = "x"\nunit = "m"\ndelay = 0.0')
    with pytest.raises(UserError) as caught:
        survey(readers.open_log(tmp_path / "log.toml"))
    assert got in str(caught.value)
    assert str(caught.value).startswith("log.toml: run.mat: ")


@pytest.mark.parametrize(
    "write", [write for name, write in recorded.FORMATS.items() if name.startswith(("bag", "MCAP"))]
)
def test_what_is_received_when_it_is_stamped_did_not_come_before(write, tmp_path):
    """As in a bag of simulated time. Today's seconds are doubles a quarter of a microsecond apart: both are rounded alike."""
    t = 1_700_000_000 + np.random.default_rng(5).integers(1, 10**9, 2000).cumsum() * 1e-9
    found = survey(readers.open_log(write(tmp_path, recorded.Run(t, t, np.sin(t), t[:1], t[:1]))))
    assert found.channels["y1"].delays.most == 0.0


@pytest.mark.parametrize("write", [recorded.mcap_of_ros2, recorded.mcap_of_json])
def test_damage_in_the_middle_is_not_passed_over(plain, write, tmp_path):
    path = write(tmp_path, plain[2])
    file = next(tmp_path.glob("run.*"))
    data = bytearray(file.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 40] = b"\xff" * 40
    file.write_bytes(data)
    with pytest.raises(UserError, match="expected a complete"):
        survey(readers.open_log(path))


def test_what_is_no_flight_log_is_one_sentence(tmp_path):
    (tmp_path / "run.ulg").write_bytes(b"not a log")
    with pytest.raises(UserError, match="expected a complete ULog"):
        survey(readers.open_log(recorded.write_toml(tmp_path, "run.ulg", ("angle", "motor"), field="x")))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            'log = "run.csv"\n[channels.y1]\nfield = "x"\ndelay = 0.0',
            "channels.y1: got no unit, expected what",
        ),
        ('log = "run.csv"\n[channels.y1]\nfield = "x"\nunit = "m"', "channels.y1: got neither arrived nor delay"),
        ('log = "run.csv"\n[channels.y1]\nfield = "z"\nunit = "m"\ndelay = 0.0', "'z' is no column here"),
        (
            'log = "none.csv"\n[channels.y1]\nfield = "x"\nunit = "m"',
            "got none.csv, expected a file or folder next to it",
        ),
        (
            'log = "run.xyz"\n[channels.y1]\nfield = "x"\nunit = "m"',
            "got run.xyz, expected a folder of ROS 2 or one of",
        ),
        ('log = "run.csv"\n[channels]', "channels"),
        ("log = ", "expected TOML such as"),
    ],
)
def test_a_mistake_in_the_toml_is_one_sentence(tmp_path, text, sentence):
    for name in ("run.csv", "run.xyz"):
        (tmp_path / name).write_text("t,x\n0,1\n1,2\n")
    (tmp_path / "log.toml").write_text(text)
    with pytest.raises(UserError) as caught:
        survey(readers.open_log(tmp_path / "log.toml"))
    assert sentence in str(caught.value)


def test_a_table_of_any_shape_is_a_log(plain, tmp_path):
    _, _, known = plain
    rows(tmp_path, {"stamp": known.sampled, "came": known.arrived, "x": known.value})
    (tmp_path / "log.toml").write_text(
        'log = "measurements.csv"\n[channels.y1]\nfield = "x"\nunit = "rad"\nsampled = "stamp"\narrived = "came"\nscale = 2.0'
    )
    (batch,) = readers.open_log(tmp_path / "log.toml").measurements()
    np.testing.assert_array_equal(batch.value, 2.0 * known.value)
    np.testing.assert_array_equal(batch.arrived, known.arrived)
