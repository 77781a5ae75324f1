"""Open a recording by its name: a folder or file of tables, or a TOML that maps the fields of another file to channels.

    log = "flight.mcap"                 # next to the TOML: .bag, a folder or .db3 of ROS 2, .mcap, .ulg, .mat, .csv, .parquet
    [channels.y1]
    topic = "/camera/pose"              # for files with topics
    frame = "camera"                    # for /tf: the child frame
    field = "pose.position.x"           # or formula = "yaw(pose.orientation)"
    unit = "m"                          # required, as bags have no units
    scale = 1.0                         # the channel's value is scale times the field,
    offset = 0.0                        # plus this, such as minus the operating point
    sampled = "header.stamp"            # field of the timestamp; default: that of the format
    period = 0.1                        # [s], instead of timestamps: rows come at 0, 0.1, 0.2 ...
    arrived = "received"                # field of the arrival time; "received": the receive time of the recorder
    delay = 0.05                        # [s], instead of arrived: delay of every sample after its timestamp
    clock_offset = 0.0                  # [s], added to the timestamps
    only_changes = false                # true: a repeated value is not a measurement
    std = "accuracy"                    # field of each value's standard deviation, or
    variance = "covariance.0"           # of its variance; before `scale`
    [inputs.u1]
    [truth.position]                    # the same keys, with t instead of sampled, without arrivals

Channels are in the order of the TOML. `time_unit` applies to timestamps without a time type; default: "s". A row without a
value (an empty cell, NaN, null) is not a measurement. `period`, `time_unit` and the table `[csv]` apply to the whole file. A
TOML may also correct tables of measurements: see `corrections`.
"""

import heapq
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pcbench import toml_text
from pcbench.errors import UserError, first_sentence, unknown
from pcbench.recordings import matlab, mcap, rosbag, tables, ulog
from pcbench.recordings.corrections import Changes, ChannelCorrection, TablesToml, correct_tables
from pcbench.recordings.csv_dialects import CSV_DEFAULTS, CsvOptions
from pcbench.recordings.formulas import quantity
from pcbench.recordings.inputs_and_truth import Times, merge, table_of
from pcbench.recordings.log import SECONDS, Batch, Columns, Log, Source, Table
from pcbench.recordings.messages import RECEIVED
from pcbench.signal_names import unit
from pcbench.toml_text import TomlTable

M = TypeVar("M", bound=BaseModel)


class Column(BaseModel):
    """Location of a channel, an input or a state in a file."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    field: str | None = None
    formula: str | None = Field(None, description="of fields, instead of one: see `formulas`")
    unit: str = Field(description="of the value")
    topic: str = ""
    frame: str = Field("", description="of a topic of transforms such as /tf: the child frame")
    scale: float = 1.0
    offset: float = 0.0
    sampled: str | None = None
    t: str | None = None
    period: float | None = Field(None, gt=0, description="[s] from one row to the next, where there is no time")
    arrived: str | None = None
    delay: float | None = Field(None, ge=0)
    clock_offset: float = 0.0
    only_changes: bool = False
    std: str | None = None
    variance: str | None = None


class Mapping(BaseModel):
    """The keys of a TOML that maps fields."""

    model_config = ConfigDict(extra="forbid")
    log: str
    time_unit: Literal[*SECONDS] | None = None  # type: ignore[valid-type]
    csv: CsvOptions = CSV_DEFAULTS
    period: float | None = Field(None, gt=0)
    channels: dict[str, Column] = Field(min_length=1)
    inputs: dict[str, Column] = {}
    truth: dict[str, Column] = {}


class Format(NamedTuple):
    """How one kind of file is read."""

    columns: Callable[[Source], Iterator[Columns]]
    stamp: str  # default field of timestamps
    arrived: str | None  # default field of arrival times


BAG = Format(rosbag.columns, "header.stamp", RECEIVED)
MCAP = Format(mcap.columns, "header.stamp", RECEIVED)
MESSAGES = (BAG, MCAP)  # formats that hold messages
TABLE = Format(tables.columns, "t", None)
FORMATS = {
    ".bag": BAG,
    ".db3": BAG,
    "": BAG,
    ".mcap": MCAP,
    ".ulg": Format(ulog.columns, "timestamp_sample", "timestamp"),
    ".mat": Format(matlab.columns, "t", None),
    **dict.fromkeys((".csv", ".parquet", ".txt", ".tsv", ".tum", ".dat", ".lvm"), TABLE),
}


def open_log(name: str | Path | tables.Frames, delay: float | None = None) -> Log:
    """Return the log of a name, or of frames in memory; raise UserError if it does not exist or needs a TOML."""
    if delay is not None and not delay >= 0:
        raise UserError(f"--delay: got {delay:g}, expected 0 s or more; write the delay of the samples.")
    if not isinstance(name, str | Path):
        return tables.open_tables(name, delay)
    path = Path(name)
    if not path.exists():
        raise UserError(f"{path}: there is no such file or folder; give a recording as in pcbench guide recordings.")
    if path.suffix.lower() == ".toml":
        return open_toml(path, delay)
    if path.is_dir() or tables.has_channels(path):
        return tables.open_tables(path, delay)
    raise UserError(
        f"{path}: got a file without defined channels, expected a TOML that maps its topics and fields to channels; write "
        f"one with pcbench info {path} --toml."
    )


def open_toml(path: Path, delay: float | None = None) -> Log:
    """Return the log that a TOML describes; raise UserError with the invalid key."""
    raw = _parse(path)
    if isinstance(log_name := raw.get("log"), str) and not (path.parent / log_name).exists():
        raise UserError(f"{path.name}: log: got {log_name}, expected a file or folder next to it; correct the name.")
    if isinstance(log_name, str) and has_tables(path.parent / log_name) and not _maps_fields(raw):
        return _open_with_corrections(path, _validate(TablesToml, raw, path), delay)
    toml = _validate(Mapping, raw, path)
    for section in ("channels", "inputs", "truth"):
        for name, column in getattr(toml, section).items():
            unit(column.unit, f"{path.name}: {section}.{name}.unit")
    file = path.parent / toml.log
    kind = format_of(file, f"{path.name}: log")
    columns = [*toml.channels.values(), *toml.inputs.values(), *toml.truth.values()]
    _require_one_time_axis(toml, kind, file, path.name)
    if kind not in MESSAGES and (frame := next((c.frame for c in columns if c.frame), None)):
        raise UserError(f"{path.name}: frame: got '{frame}', expected it of bags and MCAP files alone; leave it out.")
    for c in columns:
        c.period = c.period or (None if c.sampled or c.t else toml.period)
    topics = {c.topic for c in columns}
    source = Source(file, "", [], set(), toml.time_unit, path.name, topics=topics, cache={}, csv=toml.csv)
    channels = [_channel(c, kind, source, i, name, delay) for i, (name, c) in enumerate(toml.channels.items())]

    def measurements() -> Iterator[Batch]:
        return heapq.merge(*(read() for read in channels), key=lambda batch: batch.sampled[0])

    inputs, truth = (_table(getattr(toml, section), kind, source, section) for section in ("inputs", "truth"))
    units = tuple(c.unit for c in toml.channels.values())
    return Log(path.name, tuple(toml.channels), measurements, inputs, truth, units)


def _require_one_time_axis(toml: Mapping, kind: Format, file: Path, where: str) -> None:
    """Raise UserError if a period has no effect, or if a table mixes a period with a column of times."""
    by_key = {f"{key}.{name}": c for key in ("channels", "inputs", "truth") for name, c in getattr(toml, key).items()}
    has_time = [c.period is not None or bool(c.sampled or c.t) for c in by_key.values()]
    if toml.period and all(has_time):
        raise UserError(
            f"{where}: got a period and times of {next(iter(by_key))}, expected one of them; leave one out, or write the "
            "period there."
        )
    with_period = next((name for name, c in by_key.items() if c.period or toml.period), None)
    if kind is not TABLE or with_period is None:
        return
    if not toml.period and not all(has_time):
        raise UserError(
            f"{where}: got a period of {with_period} and no time of {list(by_key)[has_time.index(False)]}, expected both of "
            "one kind for the rows of a table; write the period of the whole file, or name the column of times there."
        )
    time_columns = {c.sampled or c.t for c in by_key.values()}
    if kind.stamp not in time_columns and any(
        tables.name_and_unit(head)[0] == kind.stamp for head in tables.heads(file, toml.csv)
    ):
        raise UserError(
            f"{where}: got a period and the column '{kind.stamp}' of times in {file.name}, expected one of them; leave the "
            "period out, or rename the column."
        )


def format_of(file: Path, where: str) -> Format:
    """Return the format of a file by its name; raise UserError for an unknown one."""
    if file.is_dir() and not (file / "metadata.yaml").is_file():
        raise UserError(
            f"{where}: the folder {file.name} has neither a table measurements.csv (or .parquet) nor a metadata.yaml of a ROS "
            "2 bag; to combine several files, see pcbench guide recording-files."
        )
    kind = FORMATS.get("" if file.is_dir() else file.suffix.lower())
    if kind is None:
        valid = ", ".join(k for k in FORMATS if k)
        raise UserError(f"{where}: got {file.name}, expected a folder of ROS 2 or one of {valid}; convert it.")
    return kind


def _parse(path: Path) -> TomlTable:
    try:
        return toml_text.parse(path.read_bytes())
    except (OSError, ValueError) as error:
        raise UserError(
            f"{path}: {first_sentence(error)}; expected TOML such as pcbench guide recordings shows; correct it."
        ) from None


def _validate(model: type[M], raw: TomlTable, path: Path) -> M:
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        if first["type"] == "missing" and first["loc"][-1] == "unit":
            place = ".".join(map(str, first["loc"][:-1]))
            raise UserError(
                f'{path.name}: {place}: got no unit, expected what its values are in; write unit = "m".'
            ) from None
        if first["type"] == "extra_forbidden":
            *parents, key = first["loc"]
            where = f"{path.name}: {'.'.join(map(str, parents))}" if parents else path.name
            raise unknown(where, "key", str(key), _keys(model, parents)) from None
        if place in ("channels", "log") and first["type"] in ("missing", "too_short"):
            problem = 'channel, expected one at least; write [channels.y1] with field = "NAME" and unit = "m"'
            problem = problem if place == "channels" else "log, expected the name of the file; write log = NAME"
            raise UserError(f"{path.name}: got no {problem}, or remove the # before those that you need.") from None
        if place == "log":
            raise UserError(
                f'{path.name}: log is the name of one file or folder; write log = "camera.csv". To combine several files, see '
                "pcbench guide recording-files."
            ) from None
        problem = first["msg"][0].lower() + first["msg"][1:]
        raise UserError(f"{path.name}: {place}: {problem}; see pcbench guide recordings for its keys.") from None


def _keys(model: type[BaseModel], parents: list[int | str]) -> Iterable[str]:
    """Return the keys of a table of a TOML."""
    if not parents:
        return model.model_fields
    kind = model.model_fields[str(parents[0])].annotation
    (inner,) = [part for part in (kind, *get_args(kind)) if isinstance(part, type) and issubclass(part, BaseModel)]
    return inner.model_fields


def _maps_fields(raw: TomlTable) -> bool:
    """Return whether a TOML maps fields to channels."""
    channels = raw.get("channels")
    entries = channels.values() if isinstance(channels, dict) else ()
    return any(isinstance(c, dict) and c.keys() & {"field", "formula"} for c in entries)


def has_tables(file: Path) -> bool:
    """Return whether a file or folder has tables with channel names in them."""
    if file.is_dir():
        return any((file / f"measurements{kind}").is_file() for kind in tables.KINDS)
    return tables.has_channels(file)


def _open_with_corrections(path: Path, toml: TablesToml, delay: float | None) -> Log:
    """Return tables with the corrections of a TOML; `delay` [s] is that of channels without one."""
    file, needs_delay = path.parent / toml.log, not tables.has_arrivals(path.parent / toml.log)
    log = tables.open_tables(file, 0.0 if needs_delay else delay)
    if needs_delay and delay is not None:
        corrections = {name: toml.channels.get(name, ChannelCorrection()) for name in log.channels}
        completed = {name: c.model_copy(update={"delay": delay}) for name, c in corrections.items() if c.delay is None}
        toml = toml.model_copy(update={"channels": toml.channels | corrections | completed})
    return correct_tables(log, toml, path.name, needs_delay)._replace(name=path.name)


def _channel(
    c: Column, kind: Format, source: Source, index: int, name: str, delay: float | None
) -> Callable[[], Iterator[Batch]]:
    """Return a function that reads a channel; `delay` [s] or its own replaces arrival times."""
    where, fixed_delay = f"{source.where}: channels.{name}", delay if c.delay is None else c.delay
    stamp, times = _stamps(c, c.sampled, kind, where)
    arrival_field = c.arrived or (None if fixed_delay is not None or c.period else kind.arrived)
    if arrival_field is None and fixed_delay is None:
        raise UserError(
            f"{where}: got neither arrived nor delay, expected one: this kind of file has no arrival times; "
            "write delay = 0.0 if they came at once."
        )
    if c.arrived and fixed_delay is not None:
        raise UserError(f"{where}: got arrived and a delay, expected one of them; leave one out.")
    if c.std and c.variance:
        raise UserError(f"{where}: got std and variance, expected one of them; leave one out.")
    if c.t:
        raise UserError(f"{where}: got t, expected sampled, the key of a channel; write sampled.")
    noise_field, value = c.std or c.variance, quantity(c.field, c.formula, c.scale, c.offset, where)
    time_fields = [name for name in (stamp, arrival_field) if name]
    fields = [*value.fields, *time_fields, *([noise_field] if noise_field else [])]
    source = source._replace(topic=c.topic, frame=c.frame, fields=fields, times=set(time_fields))

    def read() -> Iterator[Batch]:
        row, evaluate, changes = 1, value.evaluator(), Changes()
        for part in kind.columns(source):
            values = evaluate(part)
            count, std = len(values), np.zeros(0)
            rows = np.arange(row, row + count, dtype=np.int64)
            row += count
            stamps = times(part, rows) + c.clock_offset
            arrivals = part[arrival_field] if arrival_field else stamps + (fixed_delay or 0.0)
            if noise_field:  # empty or negative values become 0, which `require_sound` refuses
                std = np.nan_to_num(np.maximum(part[noise_field], 0.0), nan=0.0, posinf=np.inf)
                std = abs(c.scale) * (std if c.std else np.sqrt(std))
            is_measured = ~np.isnan(values)  # without a value, nothing was measured
            if c.only_changes:
                is_measured[is_measured] = changes(values[is_measured])
            if is_measured.any():
                yield Batch(np.full(count, index), stamps, arrivals, values, rows, std).select(is_measured)

    return read


def _stamps(c: Column, field: str | None, kind: Format, where: str) -> tuple[str | None, Times]:
    """Return the field of timestamps, if there is one, and a function for the timestamps [s] of rows."""
    if field and c.period:
        raise UserError(f"{where}: got a field of times and a period, expected one of them; leave one out.")
    if (period := c.period) is not None:
        return None, lambda _, rows: period * (rows - 1.0)
    name = field or kind.stamp
    return name, lambda part, _: part[name]


def _table(columns: dict[str, Column], kind: Format, source: Source, section: str) -> Table | None:
    """Return inputs or truth from one topic or several; those of one topic with one time are read together."""
    if not columns:
        return None
    groups: dict[tuple[object, ...], dict[str, Column]] = {}
    for name, c in columns.items():
        for key in ("std", "variance", "sampled", "arrived", "delay", "clock_offset", "only_changes"):
            if key in c.model_fields_set:
                remedy = "name the column of the times by t instead" if key == "sampled" else "leave it out"
                raise UserError(
                    f"{source.where}: {section}.{name}: got {key}, expected it of channels alone; {remedy}."
                )
        groups.setdefault((c.topic, c.frame, c.t, c.period), {})[name] = c
    topic_tables = []
    for group in groups.values():
        c = next(iter(group.values()))
        stamp, times = _stamps(c, c.t, kind, f"{source.where}: {section}")
        values = {
            name: quantity(c.field, c.formula, c.scale, c.offset, f"{source.where}: {section}.{name}")
            for name, c in group.items()
        }
        fields = list(
            dict.fromkeys([*(field for value in values.values() for field in value.fields), *filter(None, [stamp])])
        )
        topic_source = source._replace(
            topic=c.topic,
            frame=c.frame,
            fields=fields,
            times={name for name in [stamp] if name},
            default_stamp=c.t is None,
        )
        topic_tables.append(table_of(partial(kind.columns, topic_source), times, values, f"{source.where}: {section}"))
    return merge(topic_tables, list(columns), hold=section == "inputs")
