"""A run written as a recorder would: bags of ROS 1 and 2, MCAP, a flight log of PX4, a MATLAB file; and the TOML beside it.

Each format is written by the library that belongs to it, but for ULog: its own keeps what it has read, so its records are
written here byte by byte, as https://docs.px4.io/main/en/dev_log/ulog_file_format.html describes them.
"""

import json
import struct
from functools import partial
from typing import NamedTuple

import numpy as np

NS = 1_000_000_000
TOPICS = ("/camera", "/motor")
POINT = "geometry_msgs/msg/PointStamped"


class Run(NamedTuple):
    """What arrived of a run, and the input held from t on."""

    sampled: np.ndarray  # [K] s
    arrived: np.ndarray  # [K] s
    value: np.ndarray  # [K]
    t: np.ndarray  # [T] s
    u: np.ndarray  # [T]


def ns(t):
    return round(float(t) * NS)


def events(run):
    """(topic, received [s], stamp [s], number) in the order in which a recorder gets them."""
    camera, motor = TOPICS
    every = [(camera, b, a, x) for a, b, x in zip(run.sampled, run.arrived, run.value, strict=True)]
    every += [(motor, a, a, x) for a, x in zip(run.t, run.u, strict=True)]
    return sorted(every, key=lambda row: row[1])


def write_toml(folder, file, topics=TOPICS, **more):
    """Write a TOML beside a file that says: y1 is a field of the first topic, u1 of the second."""
    channel = {"topic": topics[0], "field": "point.x", "unit": "rad"} | more
    put_in = {"topic": topics[1]} | {key: channel[key] for key in ("field", "unit")}
    lines = [f'log = "{file}"']
    for table, keys in (("channels.y1", channel), ("inputs.u1", put_in)):
        lines += [f"[{table}]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    path = folder / "log.toml"
    path.write_text("\n".join(lines))
    return path


def bag(folder, run, ros, frame_id=""):
    """A bag with points that have a stamp, written by rosbags; its TOML."""
    from rosbags.rosbag1 import Writer as One
    from rosbags.rosbag2 import Writer as Two
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    name = "run.bag" if ros == 1 else "run"
    Time, Header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    Point, Message = store.types["geometry_msgs/msg/Point"], store.types[POINT]
    more = {"seq": 0} if ros == 1 else {}
    write = store.serialize_ros1 if ros == 1 else store.serialize_cdr
    with One(folder / name) if ros == 1 else Two(folder / name, version=9) as file:
        there = {topic: file.add_connection(topic, POINT, typestore=store) for topic in TOPICS}
        for topic, received, stamp, x in events(run):
            header = Header(stamp=Time(sec=ns(stamp) // NS, nanosec=ns(stamp) % NS), frame_id=frame_id, **more)
            message = Message(header=header, point=Point(x=float(x), y=0.0, z=0.0))
            file.write(there[topic], ns(received), write(message, POINT))
    return write_toml(folder, name)


DEFINITION = """std_msgs/Header header
geometry_msgs/Point point
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
"""


def mcap_of_ros2(folder, run, frame_id=""):
    """An MCAP file with messages of ROS 2, written by mcap-ros2-support; its TOML."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    with (folder / "run.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        schema = writer.register_msgdef(POINT, DEFINITION)
        for topic, received, stamp, x in events(run):
            header = {"stamp": {"sec": ns(stamp) // NS, "nanosec": ns(stamp) % NS}, "frame_id": frame_id}
            point = {"x": float(x), "y": 0.0, "z": 0.0}
            writer.write_message(topic, schema, {"header": header, "point": point}, log_time=ns(received))
        writer.finish()
    return write_toml(folder, "run.mcap")


def mcap_of_json(folder, run, frame_id="", chunks=True):
    """An MCAP file with JSON, written by mcap, in chunks or not; its TOML."""
    from mcap.writer import CompressionType, Writer

    with (folder / "run.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, use_chunking=chunks)
        writer.start()
        schema = writer.register_schema(name="point", encoding="jsonschema", data=b"{}")
        there = {topic: writer.register_channel(topic, "json", schema) for topic in TOPICS}
        for topic, received, stamp, x in events(run):
            header = {"stamp": {"sec": ns(stamp) // NS, "nsec": ns(stamp) % NS}, "frame_id": frame_id}
            text = json.dumps({"header": header, "point": {"x": float(x)}}).encode()
            writer.add_message(there[topic], ns(received), text, ns(received))
        writer.finish()
    return write_toml(folder, "run.mcap")


MAGIC = b"ULog\x01\x12\x35"


def ulog(folder, run):
    """A flight log of version 1 with topics angle and motor, byte by byte; its TOML."""

    def record(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    def us(t):
        return round(float(t) * 1e6)

    formats = (b"angle:uint64_t timestamp;uint64_t timestamp_sample;double x;", b"motor:uint64_t timestamp;double x;")
    parts = [MAGIC, struct.pack("<BQ", 1, 0), record("B", bytes(40)), *(record("F", each) for each in formats)]
    parts += [record("A", struct.pack("<BH", 0, i) + name) for i, name in enumerate((b"angle", b"motor"))]
    for topic, received, stamp, x in events(run):
        data = struct.pack("<HQQd", 0, us(received), us(stamp), x)
        parts.append(record("D", data if topic == TOPICS[0] else struct.pack("<HQd", 1, us(stamp), x)))
    (folder / "run.ulg").write_bytes(b"".join(parts))
    return write_toml(folder, "run.ulg", ("angle", "motor"), field="x")


def matlab(folder, run):
    """A MATLAB file with a struct for each topic, written by SciPy; its TOML."""
    from scipy.io import savemat

    camera = {"t": run.sampled, "came": run.arrived, "x": run.value}
    savemat(folder / "run.mat", {"camera": camera, "motor": {"t": run.t, "x": run.u}})
    return write_toml(folder, "run.mat", ("camera", "motor"), field="x", arrived="came")


FORMATS = {
    "bag of ROS 1": partial(bag, ros=1),
    "bag of ROS 2": partial(bag, ros=2),
    "MCAP of ROS 2": mcap_of_ros2,
    "MCAP of JSON": mcap_of_json,
    "MCAP without chunks": partial(mcap_of_json, chunks=False),
    "flight log": ulog,
    "MATLAB": matlab,
}
