"""A TOML that says what of another file is which channel: of a bag, a flight log, a MATLAB file, a table of another shape.

    log = "flight.mcap"                 # beside the TOML: .bag, a folder or .db3 of ROS 2, .mcap, .ulg, .mat, .csv, .parquet
    [channels.y1]
    topic = "/camera/pose"              # of what has topics
    field = "pose.position.x"
    unit = "m"                          # it must be said: a bag does not
    scale = 1.0                         # the channel's value is scale times the field
    sampled = "header.stamp"            # the field that holds the stamp; left out: as `FORMATS` has it
    arrived = "received"                # the field that holds the arrival; "received": when the recorder got the message
    delay = 0.05                        # [s], in place of arrived: every sample is so late
    [inputs.u1]
    [truth.position]                    # likewise, with t in place of sampled, and nothing for arrivals

Channels stand in the order of the TOML. `time_unit` is of stamps that are plain numbers: "s" where it is left out.
"""

import heapq
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pcbench import toml_text
from pcbench.errors import UserError, said
from pcbench.recordings import matlab, mcap, rosbag, tables, ulog
from pcbench.recordings.log import Batch, Floats, Log, Rows, Table
from pcbench.recordings.messages import RECEIVED
from pcbench.recordings.units import SECONDS
from pcbench.signal_names import unit


class Column(BaseModel):
    """What says where a channel, an input or a state stands."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    field: str
    unit: str = Field(description="of the value")
    topic: str = ""
    scale: float = 1.0
    sampled: str | None = None
    t: str | None = None
    arrived: str | None = None
    delay: float | None = Field(None, ge=0)


class Mapping(BaseModel):
    """The whole TOML."""

    model_config = ConfigDict(extra="forbid")
    log: str
    time_unit: Literal[*SECONDS] | None = None  # type: ignore[valid-type]
    channels: dict[str, Column] = Field(min_length=1)
    inputs: dict[str, Column] = {}
    truth: dict[str, Column] = {}


Read = Callable[..., Iterator[dict[str, Floats]]]  # (path, topic, fields, those that are times, their unit, where)


class Format(NamedTuple):
    """How one kind of file is read."""

    reader: Callable[[set[str]], Read]  # given all topics that will be asked for, what yields parts of a topic's fields
    stamp: str  # the field of stamps, where none is named
    arrived: str | None  # and of arrivals


def _by_parts(read: Read) -> Callable[[set[str]], Read]:
    """What needs not know the topics beforehand."""
    return lambda topics: read


FORMATS = {
    ".bag": Format(_by_parts(rosbag.fields), "header.stamp", RECEIVED),
    ".db3": Format(_by_parts(rosbag.fields), "header.stamp", RECEIVED),
    "": Format(_by_parts(rosbag.fields), "header.stamp", RECEIVED),
    ".mcap": Format(_by_parts(mcap.fields), "header.stamp", RECEIVED),
    ".ulg": Format(ulog.reader, "timestamp_sample", "timestamp"),
    ".mat": Format(matlab.reader, "t", None),
    ".csv": Format(_by_parts(tables.fields), "t", None),
    ".parquet": Format(_by_parts(tables.fields), "t", None),
}


def opened(path: Path, delay: float | None = None) -> Log:
    """Return the log that a TOML describes; raise UserError naming the key that is wrong."""
    found = _read(path)
    file = path.parent / found.log
    if not file.exists():
        raise UserError(f"{path.name}: log: got {found.log}, expected a file or folder beside it; mend the name.")
    kind = FORMATS.get("" if file.is_dir() else file.suffix.lower())
    if kind is None:
        known = ", ".join(k for k in FORMATS if k)
        raise UserError(f"{path.name}: log: got {found.log}, expected a folder of ROS 2 or one of {known}; convert it.")
    every = [*found.channels.values(), *found.inputs.values(), *found.truth.values()]
    read = kind.reader({c.topic for c in every})
    names = tuple(found.channels)
    parts = [_times(c, kind, f"{path.name}: channels.{name}", delay) for name, c in found.channels.items()]

    def measurements() -> Iterator[Batch]:
        each = (_channel(read, file, c, *parts[i], i, found, path) for i, c in enumerate(found.channels.values()))
        return heapq.merge(*each, key=lambda batch: batch.sampled[0])

    inputs, truth = (
        _table(getattr(found, what), read, kind.stamp, file, found, path, what) for what in ("inputs", "truth")
    )
    return Log(path.name, names, measurements, inputs, truth)


def _read(path: Path) -> Mapping:
    try:
        given = toml_text.parse(path.read_bytes())
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: {said(error)}; expected TOML such as pcbench guide logs shows; mend it.") from None
    try:
        found = Mapping.model_validate(given)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        if first["type"] == "missing" and first["loc"][-1] == "unit":
            at = ".".join(map(str, first["loc"][:-1]))
            raise UserError(
                f'{path.name}: {at}: got no unit, expected what its values are in; write unit = "m".'
            ) from None
        what = first["msg"][0].lower() + first["msg"][1:]
        raise UserError(f"{path.name}: {place}: {what}; see pcbench guide logs for what stands there.") from None
    for what in ("channels", "inputs", "truth"):
        for name, column in getattr(found, what).items():
            unit(column.unit, f"{path.name}: {what}.{name}.unit")
    return found


def _times(c: Column, kind: Format, where: str, delay: float | None) -> tuple[str, str | None, float | None]:
    """The fields of stamp and arrival, and the delay in place of the latter."""
    late = delay if c.delay is None else c.delay
    arrived = c.arrived or (None if late is not None else kind.arrived)
    if arrived is None and late is None:
        raise UserError(
            f"{where}: got neither arrived nor delay, expected one: this kind of file does not say when samples arrived; "
            "write delay = 0.0 if they came at once."
        )
    if c.arrived and late is not None:
        raise UserError(f"{where}: got arrived and a delay, expected one of them; leave one out.")
    return c.sampled or kind.stamp, arrived, late


def _channel(
    read: Read,
    file: Path,
    c: Column,
    stamp: str,
    arrived: str | None,
    late: float | None,
    i: int,
    m: Mapping,
    path: Path,
) -> Iterator[Batch]:
    wanted = [c.field, stamp] + ([arrived] if arrived else [])
    row = 1
    for part in read(file, c.topic, wanted, set(wanted[1:]), m.time_unit, path.name):
        many = len(part[c.field])
        if many:
            came = part[arrived] if arrived else part[stamp] + (late or 0.0)
            yield Batch(np.full(many, i), part[stamp], came, c.scale * part[c.field], np.arange(row, row + many))
        row += many


def _table(
    given: dict[str, Column], read: Read, usual: str, file: Path, m: Mapping, path: Path, what: str
) -> Table | None:
    """Inputs or truth: columns of one topic, which has one time for all."""
    if not given:
        return None
    first = next(iter(given.values()))
    for name, c in given.items():
        if (c.topic, c.t) != (first.topic, first.t) or c.arrived or c.sampled or c.delay is not None:
            raise UserError(
                f"{path.name}: {what}.{name}: got other times than {what}.{next(iter(given))}, expected one topic and one t "
                f"for all {what}; write them so."
            )
    stamp = first.t or usual

    def rows() -> Iterator[Rows]:
        row = 1
        wanted = [stamp, *(c.field for c in given.values())]
        for part in read(file, first.topic, wanted, {stamp}, m.time_unit, path.name):
            values = np.stack([c.scale * part[c.field] for c in given.values()], 1)
            yield Rows(part[stamp], values, np.arange(row, row + len(values)))
            row += len(values)

    return Table(tuple(given), rows)
