"""A run as a bag, an MCAP file, a flight log or a MATLAB file is the run again: estimates are those of its tables.

What holds float64 gives the same; a flight log of PX4 is read from what its reader returns, for its writer keeps the log it has
read. Readers are of the extra `logs`: where one is not installed its test is skipped.
"""

import json
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from logged import MOTOR, rows

import pcbench
from pcbench.errors import UserError
from pcbench.logs import reading, tables
from pcbench.logs.survey import survey

WHY = "it is of the extra 'logs': pip install 'pcbench[logs]'"
NS = 1_000_000_000


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's frame and the columns of its log: stamps, arrivals and values of what arrived; t and u."""
    folder = tmp_path_factory.mktemp("run")
    frame = pcbench.trace(MOTOR, ["pccebo", "dkf"], seed=3, log=folder)
    log = tables.opened(folder)
    (batch,), (inputs,) = log.measurements(), log.inputs.read()
    came = ~np.isnan(batch.arrived)
    return frame, (batch.sampled[came], batch.arrived[came], batch.value[came]), (inputs.t, inputs.values[:, 0])


def told(folder, file, topics, **more):
    """A TOML beside a file, of topics (channel, input)."""
    each = {"field": "point.x", "unit": "rad"} | more
    lines = [f'log = "{file}"']
    for table, topic in zip(("channels.y1", "inputs.u1"), topics, strict=True):
        keys = {"topic": topic} | (
            each if table[0] == "c" else {k: v for k, v in each.items() if k in ("field", "unit")}
        )
        lines += [f"[{table}]", *(f"{k} = {json.dumps(v)}" for k, v in keys.items())]
    path = folder / "log.toml"
    path.write_text("\n".join(lines))
    assert tomllib.loads(path.read_text())
    return path


def same(path, frame):
    found = pcbench.replay(path, MOTOR, ["pccebo", "dkf"]).estimates
    for column in [c for c in found.columns if "." in c]:
        known = frame[column][: len(found)]
        np.testing.assert_allclose(found[column], known, rtol=0, atol=1e-14 * np.abs(known).max(), err_msg=column)


def ns(t):
    return round(float(t) * NS)


def points(store, run, topics):
    """(topic, received [ns], message) of a run, in the order in which they come."""
    _, (sampled, arrived, value), (t, u) = run
    known, place = store.types, "geometry_msgs/msg/Point"
    Time, Header = known["builtin_interfaces/msg/Time"], known["std_msgs/msg/Header"]
    Point, Message = known[place], known[f"{place}Stamped"]

    def message(stamp, x):
        time = Time(sec=ns(stamp) // NS, nanosec=ns(stamp) % NS)
        more = {"seq": 0} if "seq" in Header.__dataclass_fields__ else {}
        return Message(header=Header(stamp=time, frame_id="", **more), point=Point(x=float(x), y=0.0, z=0.0))

    every = [(topics[0], ns(b), message(a, x)) for a, b, x in zip(sampled, arrived, value, strict=True)]
    every += [(topics[1], ns(a), message(a, x)) for a, x in zip(t, u, strict=True)]
    return sorted(every, key=lambda row: row[1])


@pytest.mark.parametrize("ros", [1, 2])
def test_a_bag_is_the_run_again(run, tmp_path, ros):
    rosbags = pytest.importorskip("rosbags", reason=WHY)
    assert rosbags
    from rosbags.rosbag1 import Writer as One
    from rosbags.rosbag2 import Writer as Two
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    name, kind = ("run.bag" if ros == 1 else "run"), "geometry_msgs/msg/PointStamped"
    topics = ("/camera", "/motor")
    with One(tmp_path / name) if ros == 1 else Two(tmp_path / name, version=9) as bag:
        there = {topic: bag.add_connection(topic, kind, typestore=store) for topic in topics}
        write = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        for topic, received, message in points(store, run, topics):
            bag.write(there[topic], received, write(message, kind))
    same(told(tmp_path, name, topics), run[0])
    with pytest.raises(UserError, match=r"got the topic '/radar', expected one of /camera, /motor"):
        survey(reading.opened(told(tmp_path, name, ("/radar", "/motor"))))
    with pytest.raises(UserError, match=r"message 1: point\.w: got no 'w' among"):
        survey(reading.opened(told(tmp_path, name, topics, field="point.w")))


def test_an_mcap_file_is_the_run_again(run, tmp_path):
    pytest.importorskip("mcap", reason=WHY)
    from mcap.writer import Writer

    frame, (sampled, arrived, value), (t, u) = run
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="point", encoding="jsonschema", data=b"{}")
        there = [writer.register_channel(topic, "json", schema) for topic in ("/camera", "/motor")]
        every = [(there[0], a, b, x) for a, b, x in zip(sampled, arrived, value, strict=True)]
        every += [(there[1], a, a, x) for a, x in zip(t, u, strict=True)]
        for channel, stamp, received, x in sorted(every, key=lambda row: row[2]):
            text = {"header": {"stamp": {"sec": ns(stamp) // NS, "nsec": ns(stamp) % NS}}, "point": {"x": float(x)}}
            writer.add_message(channel, ns(received), json.dumps(text).encode(), ns(received))
        writer.finish()
    same(told(tmp_path, "run.mcap", ("/camera", "/motor")), frame)
    with pytest.raises(UserError, match="got the topic '/radar'"):
        survey(reading.opened(told(tmp_path, "run.mcap", ("/radar", "/motor"))))


def test_a_flight_log_is_the_run_again(run, tmp_path, monkeypatch):
    pyulog = pytest.importorskip("pyulog", reason=WHY)
    frame, (sampled, arrived, value), (t, u) = run

    def us(times):
        return np.rint(times * 1e6).astype(np.uint64)

    data = [
        {"timestamp": us(arrived), "timestamp_sample": us(sampled), "x": value},
        {"timestamp": us(t), "x": u},
    ]
    every = [SimpleNamespace(name=n, multi_id=0, data=d) for n, d in zip(("angle", "motor"), data, strict=True)]
    monkeypatch.setattr(pyulog, "ULog", lambda path: SimpleNamespace(data_list=every))
    (tmp_path / "run.ulg").write_bytes(b"")
    same(told(tmp_path, "run.ulg", ("angle", "motor"), field="x"), frame)
    with pytest.raises(UserError, match="got the topic 'gps', expected one of angle, motor"):
        survey(reading.opened(told(tmp_path, "run.ulg", ("gps", "motor"), field="x")))


def test_what_is_no_flight_log_is_one_sentence(tmp_path):
    pytest.importorskip("pyulog", reason=WHY)
    (tmp_path / "run.ulg").write_bytes(b"not a log")
    with pytest.raises(UserError, match="expected a whole ULog"):
        survey(reading.opened(told(tmp_path, "run.ulg", ("angle", "motor"), field="x")))


def test_a_matlab_file_is_the_run_again(run, tmp_path):
    from scipy.io import savemat

    frame, (sampled, arrived, value), (t, u) = run
    camera = {"t": sampled, "came": arrived, "x": value}
    savemat(tmp_path / "run.mat", {"camera": camera, "motor": {"t": t, "x": u}})
    same(told(tmp_path, "run.mat", ("camera", "motor"), field="x", arrived="came"), frame)
    with pytest.raises(UserError, match="'radar' is no struct"):
        survey(reading.opened(told(tmp_path, "run.mat", ("radar", "motor"), field="x", arrived="came")))


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
            "got none.csv, expected a file or folder beside it",
        ),
        (
            'log = "run.txt"\n[channels.y1]\nfield = "x"\nunit = "m"',
            "got run.txt, expected a folder of ROS 2 or one of",
        ),
        ('log = "run.csv"\n[channels]', "channels"),
        ("log = ", "expected TOML such as"),
    ],
)
def test_a_mistake_in_the_toml_is_one_sentence(tmp_path, text, sentence):
    for name in ("run.csv", "run.txt"):
        (tmp_path / name).write_text("t,x\n0,1\n1,2\n")
    (tmp_path / "log.toml").write_text(text)
    with pytest.raises(UserError) as caught:
        survey(reading.opened(tmp_path / "log.toml"))
    assert sentence in str(caught.value)


def test_a_table_of_any_shape_is_a_log(run, tmp_path):
    _, (sampled, arrived, value), _ = run
    rows(tmp_path, {"stamp": sampled, "came": arrived, "x": value})
    (tmp_path / "log.toml").write_text(
        'log = "measurements.csv"\n[channels.y1]\nfield = "x"\nunit = "rad"\nsampled = "stamp"\narrived = "came"\nscale = 2.0'
    )
    (batch,) = reading.opened(tmp_path / "log.toml").measurements()
    np.testing.assert_array_equal(batch.value, 2.0 * value)
    np.testing.assert_array_equal(batch.arrived, arrived)
