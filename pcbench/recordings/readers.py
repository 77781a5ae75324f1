"""A log by its name: a folder or file of tables, or a TOML that says what of another file is which channel.

    log = "flight.mcap"                 # beside the TOML: .bag, a folder or .db3 of ROS 2, .mcap, .ulg, .mat, .csv, .parquet
    [channels.y1]
    topic = "/camera/pose"              # of what has topics
    field = "pose.position.x"
    unit = "m"                          # it must be said: a bag does not
    scale = 1.0                         # the channel's value is scale times the field
    sampled = "header.stamp"            # the field that holds the stamp; left out: as `FORMATS` has it
    arrived = "received"                # the field that holds the arrival; "received": when the recorder got the message
    delay = 0.05                        # [s], in place of arrived: every sample is so late
    std = "accuracy"                    # the field of each value's standard deviation, or
    variance = "covariance.0"           # of its variance; before `scale`
    [inputs.u1]
    [truth.position]                    # likewise, with t in place of sampled, and nothing for arrivals

Channels are in the order of the TOML. `time_unit` is of stamps that are plain numbers: "s" where it is left out.
"""

import heapq
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pcbench import toml_text
from pcbench.errors import UserError, first_sentence
from pcbench.recordings import matlab, mcap, rosbag, tables, ulog
from pcbench.recordings.csv_dialects import FOUND, CsvOptions
from pcbench.recordings.log import SECONDS, Batch, Columns, Log, Source, Table, table_of
from pcbench.recordings.messages import RECEIVED
from pcbench.signal_names import unit


class Column(BaseModel):
    """What says where a channel, an input or a state is."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    field: str
    unit: str = Field(description="of the value")
    topic: str = ""
    scale: float = 1.0
    sampled: str | None = None
    t: str | None = None
    arrived: str | None = None
    delay: float | None = Field(None, ge=0)
    std: str | None = None
    variance: str | None = None


class Mapping(BaseModel):
    """All of the TOML."""

    model_config = ConfigDict(extra="forbid")
    log: str
    time_unit: Literal[*SECONDS] | None = None  # type: ignore[valid-type]
    csv: CsvOptions = FOUND
    channels: dict[str, Column] = Field(min_length=1)
    inputs: dict[str, Column] = {}
    truth: dict[str, Column] = {}


class Format(NamedTuple):
    """How one kind of file is read."""

    columns: Callable[[Source], Iterator[Columns]]
    stamp: str  # the field of stamps, where none is named
    arrived: str | None  # and of arrivals


BAG = Format(rosbag.columns, "header.stamp", RECEIVED)
TABLE = Format(tables.columns, "t", None)
FORMATS = {
    ".bag": BAG,
    ".db3": BAG,
    "": BAG,
    ".mcap": Format(mcap.columns, "header.stamp", RECEIVED),
    ".ulg": Format(ulog.columns, "timestamp_sample", "timestamp"),
    ".mat": Format(matlab.columns, "t", None),
    **dict.fromkeys((".csv", ".parquet", ".txt", ".tsv", ".tum", ".dat", ".lvm"), TABLE),
}


def open_log(name: str | Path, delay: float | None = None) -> Log:
    """Return the log of a name; raise UserError where there is none, or it needs a TOML."""
    path = Path(name)
    if delay is not None and not delay >= 0:
        raise UserError(f"--delay: got {delay:g}, expected 0 s or more; write how late samples arrive.")
    if not path.exists():
        raise UserError(f"{path}: got no such file or folder, expected a log; see pcbench guide recordings.")
    if path.suffix.lower() == ".toml":
        return open_toml(path, delay)
    if path.is_dir() or path.suffix.lower() in tables.KINDS:
        return tables.open_tables(path, delay)
    raise UserError(
        f"{path}: got a file that may hold anything, expected a TOML that says which topics and fields are channels; see "
        "pcbench guide recordings."
    )


def open_toml(path: Path, delay: float | None = None) -> Log:
    """Return the log that a TOML describes; raise UserError naming the key that is wrong."""
    toml = _read(path)
    file = path.parent / toml.log
    if not file.exists():
        raise UserError(f"{path.name}: log: got {toml.log}, expected a file or folder next to it; correct the name.")
    kind = FORMATS.get("" if file.is_dir() else file.suffix.lower())
    if kind is None:
        valid = ", ".join(k for k in FORMATS if k)
        raise UserError(f"{path.name}: log: got {toml.log}, expected a folder of ROS 2 or one of {valid}; convert it.")
    every = [*toml.channels.values(), *toml.inputs.values(), *toml.truth.values()]
    source = Source(
        file, "", [], set(), toml.time_unit, path.name, topics={c.topic for c in every}, loaded={}, csv=toml.csv
    )
    channels = [_channel(c, kind, source, i, name, delay) for i, (name, c) in enumerate(toml.channels.items())]

    def measurements() -> Iterator[Batch]:
        return heapq.merge(*(read() for read in channels), key=lambda batch: batch.sampled[0])

    inputs, truth = (_table(getattr(toml, what), kind, source, what) for what in ("inputs", "truth"))
    return Log(path.name, tuple(toml.channels), measurements, inputs, truth)


def _read(path: Path) -> Mapping:
    try:
        table = toml_text.parse(path.read_bytes())
    except (OSError, ValueError) as error:
        raise UserError(
            f"{path}: {first_sentence(error)}; expected TOML such as pcbench guide recordings shows; mend it."
        ) from None
    try:
        toml = Mapping.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        if first["type"] == "missing" and first["loc"][-1] == "unit":
            place = ".".join(map(str, first["loc"][:-1]))
            raise UserError(
                f'{path.name}: {place}: got no unit, expected what its values are in; write unit = "m".'
            ) from None
        what = first["msg"][0].lower() + first["msg"][1:]
        raise UserError(f"{path.name}: {place}: {what}; see pcbench guide recordings for its keys.") from None
    for what in ("channels", "inputs", "truth"):
        for name, column in getattr(toml, what).items():
            unit(column.unit, f"{path.name}: {what}.{name}.unit")
    return toml


def _channel(
    c: Column, kind: Format, source: Source, index: int, name: str, delay: float | None
) -> Callable[[], Iterator[Batch]]:
    """What reads a channel; `delay` [s] or its own is in place of arrivals."""
    where, late = f"{source.where}: channels.{name}", delay if c.delay is None else c.delay
    stamp, arrived = c.sampled or kind.stamp, c.arrived or (None if late is not None else kind.arrived)
    if arrived is None and late is None:
        raise UserError(
            f"{where}: got neither arrived nor delay, expected one: this kind of file does not say when samples arrived; "
            "write delay = 0.0 if they came at once."
        )
    if c.arrived and late is not None:
        raise UserError(f"{where}: got arrived and a delay, expected one of them; leave one out.")
    if c.std and c.variance:
        raise UserError(f"{where}: got std and variance, expected one of them; leave one out.")
    times = [stamp] if arrived is None else [stamp, arrived]
    spread = c.std or c.variance
    fields = [c.field, *times, *([spread] if spread else [])]
    source = source._replace(topic=c.topic, fields=fields, times=set(times))

    def read() -> Iterator[Batch]:
        row = 1
        for part in kind.columns(source):
            many = len(part[c.field])
            if many:
                came = part[arrived] if arrived else part[stamp] + (late or 0.0)
                rows, std = np.arange(row, row + many), np.zeros(0)
                if spread:  # what is empty or below 0 becomes 0, which `require_sound` refuses
                    std = np.nan_to_num(np.maximum(part[spread], 0.0), nan=0.0, posinf=np.inf)
                    std = abs(c.scale) * (std if c.std else np.sqrt(std))
                yield Batch(np.full(many, index), part[stamp], came, c.scale * part[c.field], rows, std)
            row += many

    return read


def _table(given: dict[str, Column], kind: Format, source: Source, what: str) -> Table | None:
    """Inputs or truth: columns of one topic, which has one time for all."""
    if not given:
        return None
    first = next(iter(given.values()))
    for name, c in given.items():
        if c.std or c.variance:
            key = "std" if c.std else "variance"
            raise UserError(f"{source.where}: {what}.{name}: got {key}, expected it of channels alone; leave it out.")
        if (c.topic, c.t) != (first.topic, first.t) or c.arrived or c.sampled or c.delay is not None:
            raise UserError(
                f"{source.where}: {what}.{name}: got other times than {what}.{next(iter(given))}, expected one topic and one t "
                f"for all {what}; write them so."
            )
    t = first.t or kind.stamp
    fields = {name: (c.field, c.scale) for name, c in given.items()}
    source = source._replace(topic=first.topic, fields=[t, *(c.field for c in given.values())], times={t})
    return table_of(lambda: kind.columns(source), t, fields)
