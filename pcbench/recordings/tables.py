"""A log as tables: `measurements`, `inputs` and `truth` as CSV or Parquet, in a folder or next to each other.

    flight/measurements.parquet   flight/inputs.parquet   flight/truth.parquet
    flight.parquet                flight.inputs.parquet   flight.truth.parquet

Measurements have the columns channel, sampled, arrived, value, and may have std, each value's standard deviation (empty for a
channel that has none); inputs and truth have t and one column each. A head may contain a unit of time, "sampled [ms]"; seconds
otherwise. Channels are in the order of the numbers in their names, y2 before y10.

`as_tables` writes a simulated run in this form: samples with arrival times, inputs held over ticks, and the true state.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import csv

from pcbench.errors import UserError, short, unknown, unreadable
from pcbench.recordings.csv_dialects import CSV_DEFAULTS, EMPTY, CsvOptions, Dialect, blank_squeezer, dialect
from pcbench.recordings.formulas import quantity
from pcbench.recordings.inputs_and_truth import merge, table_of
from pcbench.recordings.log import MOST, NO_TIME, SECONDS, Batch, Columns, Floats, Log, Source, Table, Topic

if TYPE_CHECKING:
    import pandas as pd

Frames = Mapping[str, "pd.DataFrame"]  # measurements, and optionally inputs and truth
KINDS = (".parquet", ".csv")
NUMBERS = (pa.types.is_floating, pa.types.is_integer, pa.types.is_decimal, pa.types.is_boolean, pa.types.is_null)
TIMES = (pa.types.is_timestamp, pa.types.is_time, pa.types.is_duration)
NULLS = [*csv.ConvertOptions().null_values, "-", "None", "none"]  # cells that count as empty
HEAD = re.compile(r"^\s*(.*?)\s*(?:\[((?!/)[^\[\]]*)\]|\(([^()]*)\))?\s*$")
LATEST = 1e11  # [s] times in seconds are below it: the year 5138
HALF_DAY = 43_200 * 10**9  # [ns]
MANY = 1 << 16  # rows of a part
BLOCK = 1 << 20  # bytes of a part of a CSV file
READ = 1 << 18  # bytes of a Parquet column that are read at once
COLUMNS = ("channel", "sampled", "value")


class Frame(NamedTuple):
    """A table in memory instead of a file."""

    name: str
    table: pa.Table
    suffix: str = ""


def open_tables(path: Path | Frames, delay: float | None = None) -> Log:
    """Return a log in tables; `delay` [s] replaces a column `arrived`. Raise UserError if a table or a column is missing."""
    measured, inputs, truth = (_file(path, kind) for kind in ("measurements", "inputs", "truth"))
    if measured is None and isinstance(path, Mapping):
        raise UserError("the recording: got no frame 'measurements', expected one; give it.")
    if measured is None:
        raise UserError(
            f"{path}: got a folder without measurements.parquet or measurements.csv, expected one of them; a bag of ROS 2 "
            "needs a TOML that maps its topics to channels (pcbench guide recordings)."
        )
    head_of = _find_columns(measured, COLUMNS)
    if "arrived" not in head_of and delay is None:
        raise UserError(
            f"{measured.name}: got no column 'arrived', expected arrival times [s]; write the column, or give --delay."
        )
    if "arrived" in head_of and delay is not None:
        raise UserError(
            f"{measured.name}: got a column 'arrived' and --delay {delay:g}, expected one of them; leave one out."
        )
    channels = _channels(measured, head_of["channel"])

    def measurements() -> Iterator[Batch]:
        column_heads, row = [head_of[name] for name in (*COLUMNS, "arrived", "std") if name in head_of], 1
        for part in batches(measured, column_heads, [head_of["channel"]]):
            stamps = column_of(part, head_of["sampled"], measured.name, time=True)
            arrivals = (
                column_of(part, head_of["arrived"], measured.name, time=True) if delay is None else stamps + delay
            )
            channel = pc.index_in(words_of(part, head_of["channel"], measured.name), pa.array(channels))
            batch = Batch(
                channel=channel.to_numpy(zero_copy_only=False).astype(int),
                sampled=stamps,
                arrived=arrivals,
                value=column_of(part, head_of["value"], measured.name),
                row=np.arange(row, row + len(part)),
                std=column_of(part, head_of["std"], measured.name) if "std" in head_of else np.zeros(0),
            )
            row += len(part)
            yield batch.select(~np.isnan(batch.value) | np.isnan(arrivals))  # without a value it was lost, or not taken

    return Log(measured.name, channels, measurements, _table(inputs, "inputs"), _table(truth, "truth"))


def _file(path: Path | Frames, kind: str) -> Path | Frame | None:
    """Return the file of one table of a log in a folder, or next to the file of the measurements; or its frame."""
    if isinstance(path, Mapping):
        if unknown_names := path.keys() - {"measurements", "inputs", "truth"}:
            raise unknown("the recording", "table", min(unknown_names), ["measurements", "inputs", "truth"])
        frame = Frame(kind, pa.table({}))
        with _convert_errors(frame):
            return (
                frame._replace(table=pa.Table.from_pandas(path[kind], preserve_index=False)) if kind in path else None
            )
    if kind == "measurements" and not path.is_dir():
        return path
    names = (path / f"{kind}{k}" if path.is_dir() else path.with_suffix(f".{kind}{k}") for k in KINDS)
    return next((name for name in names if name.is_file()), None)


def _find_columns(path: Path | Frame, names: Sequence[str]) -> dict[str, str]:
    """Return the heads of a file's columns by name, including those of `names`."""
    header = heads(path)
    column_names = [name_and_unit(head)[0] for head in header]
    head_of = {name: find_column(header, name, path.name)[0] for name in column_names if name}
    for name in names:
        find_column(header, name, path.name)
    for name, head in head_of.items():
        if name_and_unit(head)[1] and name not in ("t", "sampled", "arrived"):
            raise UserError(
                f"{path.name}: got the column '{head}', expected '{name}' in the unit of the plant; convert its numbers, "
                "or map the file with a TOML that has a scale."
            )
    return head_of


def _channels(path: Path | Frame, head: str) -> tuple[str, ...]:
    """Return every channel's name, in the order of the numbers in them."""
    names: set[str] = set()
    for part in batches(path, [head], [head]):
        names |= set(pc.unique(words_of(part, head, f"{path.name}: {head}")).to_pylist())
    if not names or None in names:
        raise UserError(
            f"{path.name}: got {'a row without a channel' if names else 'no rows'}, expected samples with the name of their "
            "channel each; correct the file."
        )

    def numbers_in(name: str) -> list[tuple[int, int, str]]:
        return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in re.split(r"(\d+)", name) if p]

    return tuple(sorted(map(str, names), key=numbers_in))


def _table(path: Path | Frame | None, kind: str) -> Table | None:
    """Return a table of t and columns of numbers."""
    if path is None:
        return None
    head_of = _find_columns(path, ["t"])
    t = head_of.pop("t")
    source = Source(cast(Path, path), "", [*head_of.values(), t], {t}, None, path.name, topics=set(), cache={})
    if not head_of:
        raise UserError(f"{path.name}: got the column t alone, expected one more at least; write the values at t.")
    quantities = {name: quantity(head, None, 1.0, 0.0, path.name) for name, head in head_of.items()}
    table = table_of(lambda: columns(source), lambda part, _: part[t], quantities, path.name)
    return merge([table], table.names, hold=kind == "inputs")


def as_tables(
    samples: Batch,
    channels: Sequence[str],
    inputs: tuple[Floats, Floats] | None = None,
    truth: tuple[Sequence[str], Floats, Floats] | None = None,
) -> dict[str, pa.Table]:
    """Return samples, inputs (t [K], u [K, m]) and truth (names, t [K], x [K, n]) as tables, by the names of their files."""
    names = pa.array(channels).take(pa.array(samples.channel))
    arrived = pa.array(samples.arrived, mask=np.isnan(samples.arrived))
    measurement_columns = {"channel": names, "sampled": samples.sampled, "arrived": arrived, "value": samples.value}
    measurement_columns |= {"std": samples.std} if np.isfinite(samples.std).any() else {}
    wide: dict[str, tuple[Sequence[str], Floats, Floats]] = {}
    if inputs is not None:
        wide["inputs"] = [f"u{i + 1}" for i in range(inputs[1].shape[1])], *inputs
    if truth is not None:
        wide["truth"] = truth
    return {"measurements": pa.table(measurement_columns)} | {
        kind: pa.table({"t": t} | {name: np.ascontiguousarray(v) for name, v in zip(names, values.T, strict=True)})
        for kind, (names, t, values) in wide.items()
    }


def heads(path: Path | Frame, options: CsvOptions = CSV_DEFAULTS) -> list[str]:
    """Return the heads of a file's columns as written; raise UserError if it cannot be read."""
    if isinstance(path, Frame):
        return list(map(str, path.table.column_names))
    with _convert_errors(path):
        return list(pq.read_schema(path).names if path.suffix.lower() == ".parquet" else dialect(path, options).names)


def has_channels(path: Path) -> bool:
    """Return whether a file is a table with a column of channels."""
    return path.suffix.lower() in KINDS and any(name_and_unit(head)[0] == "channel" for head in heads(path))


def has_arrivals(path: Path) -> bool:
    """Return whether the measurements of a folder or file have the column arrived."""
    file = _file(path, "measurements")
    return file is not None and any(name_and_unit(head)[0] == "arrived" for head in heads(file))


def name_and_unit(head: str) -> tuple[str, str | None]:
    """Return the name and the unit of a column's head, such as "sampled [ms]"; None without a unit."""
    match = HEAD.match(head)
    return (match[1], match[2] or match[3]) if match else (head, None)


def batches(
    path: Path | Frame, names: Sequence[str], words: Sequence[str] = (), options: CsvOptions = CSV_DEFAULTS
) -> Iterator[pa.RecordBatch]:
    """Yield the columns `names` in parts; all except those of `words` are numbers or times. Errors name the file."""
    if isinstance(path, Frame):
        yield from path.table.select(list(names)).to_batches(MANY)
        return
    if path.suffix.lower() == ".parquet":
        # the default reads a group's whole column first
        with _convert_errors(path), pq.ParquetFile(path, buffer_size=READ, pre_buffer=False) as file:
            yield from file.iter_batches(MANY, columns=list(names), use_threads=False)
        return
    with _convert_errors(path):
        d = dialect(path, options)
    types = {n: pa.string() if n in words else kind for n, kind in zip(d.names, d.types, strict=True) if n in names}
    convert_options = csv.ConvertOptions(
        column_types=types, include_columns=list(names), decimal_point=d.decimal, null_values=NULLS
    )
    read_options = csv.ReadOptions(
        block_size=BLOCK, use_threads=False, encoding=d.encoding, column_names=d.names, skip_rows=d.skip
    )
    parse_options = csv.ParseOptions(
        delimiter=d.separator, invalid_row_handler=lambda row: "skip" if EMPTY.fullmatch(row.text) else "error"
    )
    with _convert_errors(path, d), pa.OSFile(str(path)) as raw:
        text = pa.TransformInputStream(raw, blank_squeezer()) if d.separator == " " else raw
        with csv.open_csv(text, read_options, parse_options, convert_options) as file:
            yield from file


def columns(source: Source) -> Iterator[Columns]:
    """Yield parts of columns; empty cells are NaN. A field may omit its unit, or be a part of a column: `pose.position.x`."""
    header = heads(source.path, source.csv)
    paths = {field: find_column(header, field, source.place, field in source.times) for field in source.fields}
    for part in batches(source.path, sorted({head for head, _ in paths.values()}), options=source.csv):
        yield {
            name: column_of(part, head, source.where, inner, time=name in source.times, unit=source.unit)
            for name, (head, inner) in paths.items()
        }


def topics(source: Source) -> Iterator[Topic]:
    """Yield the one topic of a table: its columns, and the fields of structs."""
    with _convert_errors(source.path):
        if source.path.suffix.lower() == ".parquet":
            types = [(field.name, field.type) for field in pq.read_schema(source.path)]
        else:
            d = dialect(source.path, source.csv)
            types = list(zip(d.names, d.types, strict=True))
    counts = Counter(name for name, _ in types)
    types = [(name, kind) for name, kind in types if name and counts[name] == 1]
    several = ", ".join(f"{many} columns '{name}'" for name, many in counts.items() if name and many > 1)
    problem = f"{several}: left out, as their names are the same; rename them." if several else ""
    numbers, times, words = list[str](), list[str](), list[str]()
    while types:
        name, kind = types.pop(0)
        if pa.types.is_struct(kind):
            types = [(f"{name}.{field.name}", field.type) for field in kind] + types
        elif any(is_kind(kind) for is_kind in (*TIMES, pa.types.is_date)):
            times.append(name)
        elif any(is_kind(kind) for is_kind in NUMBERS):
            numbers.append(name)
        elif pa.types.is_string(kind) or pa.types.is_large_string(kind):
            words.append(name)
    yield Topic("", "table", numbers[:MOST], times, words=words, problem=problem)


def find_column(header: Sequence[str], field: str, where: str, time: bool = False) -> tuple[str, str]:
    """Return the head of a field's column, and the path within it; raise UserError for none, or several."""
    names = [name_and_unit(head)[0] for head in header]
    parts = field.split(".")
    for length in range(len(parts), 0, -1):
        name = ".".join(parts[:length])
        matches = [head for head in header if head == name]
        matches = matches or [h for h, b in zip(header, names, strict=True) if b == name]
        if len(matches) > 1:
            raise UserError(f"{where}: got {len(matches)} columns '{name}', expected one; rename them.")
        if matches:
            return matches[0], ".".join(parts[length:])
    raise unknown(where, f"column{NO_TIME if time else ''} here", field, header)


def column_of(
    part: pa.RecordBatch, head: str, where: str, inner: str = "", *, time: bool = False, unit: str | None = None
) -> Floats:
    """Return a column, or a part of it, as numbers; empty cells are NaN, a `time` is in seconds, of `unit` or the head's.

    Raises UserError if it contains something else, or if its unit is unknown or missing.
    """
    column, where, head_unit = part.column(head), f"{where}: {head}", name_and_unit(head)[1]
    if time and unit and head_unit in SECONDS and head_unit != unit:
        raise UserError(
            f"{where}: got the time_unit {unit}, expected {head_unit} as in the head; leave time_unit out, or correct it."
        )
    unit = unit or head_unit
    for name in filter(None, inner.split(".")):
        column = _within(column, name, where)
    column = pc.cast(column, pa.timestamp("s")) if time and pa.types.is_date(column.type) else column
    if time and any(is_kind(column.type) for is_kind in TIMES):
        if (
            pa.types.is_time(column.type)
            and (np.diff(pc.cast(column, pa.time64("ns")).cast(pa.int64())) < -HALF_DAY).any()
        ):
            raise UserError(
                f"{where}: got times of day that pass midnight, expected times that rise; write them with dates."
            )
        integer_type = pa.int32() if pa.types.is_time32(column.type) else pa.int64()
        column, unit = pc.cast(column, integer_type), column.type.unit
    if not any(is_kind(column.type) for is_kind in NUMBERS):
        got = f"'{short(str(column[0]))}'" if len(column) and isinstance(column[0].as_py(), str) else column.type
        times = ", or times such as 2026-03-01T12:00:00.050" if time else ""
        raise UserError(f"{where}: got {got}, expected numbers{times}; correct the column.")
    if time and unit is not None and unit not in SECONDS:
        raise unknown(where, "unit of time", unit, SECONDS)
    numbers = np.asarray(pc.cast(column, pa.float64(), safe=False).to_numpy(zero_copy_only=False), float)
    if not time:
        return numbers
    if unit is None and numbers.size and np.nanmax(np.abs(numbers), initial=0.0) > LATEST:
        raise UserError(
            f"{where}: got {np.nanmax(np.abs(numbers)):.4g} without a unit, expected seconds; write the unit into the column's "
            "head, such as 'sampled [ns]', or time_unit in a TOML."
        )
    return numbers * SECONDS[unit or "s"]


def _within(column: pa.Array, name: str, where: str) -> pa.Array:
    """Return a field of a column of structs, or an entry of one of lists, from 0."""
    if pa.types.is_struct(column.type):
        inner = [field.name for field in column.type]
        if name not in inner:
            raise unknown(where, "field", name, inner)
        return pc.struct_field(column, name)
    if pa.types.is_list(column.type) and name.isdecimal():
        return pa.array(
            [None if row is None or len(row) <= int(name) else row[int(name)] for row in column.to_pylist()]
        )
    raise UserError(f"{where}: got {column.type}, which has no '{name}', expected a column of fields; write its name.")


def words_of(part: pa.RecordBatch, head: str, where: str) -> pa.Array:
    """Return a column of words; raise UserError if it contains something else."""
    column = part.column(head)
    column = column.dictionary_decode() if pa.types.is_dictionary(column.type) else column
    try:
        return pc.cast(column, pa.string())
    except pa.ArrowException:
        raise UserError(f"{where}: got {column.type}, expected names of channels; correct the column.") from None


CELL = re.compile(r"In CSV column #(\d+): Row #(\d+): CSV conversion error to (\w+).*: invalid value '(.*)'")
ZONE = re.compile(
    r"In CSV column #(\d+): Row #(\d+): CSV conversion error to .*: expected (no|a) zone offset in '(.*)'"
)
ROW = re.compile(r"CSV parse error: Row #(\d+): Expected (\d+) columns, got (\d+)")


@contextmanager
def _convert_errors(path: Path | Frame, d: Dialect | None = None) -> Iterator[None]:
    """Convert any exception of a reader into a UserError with the file and, for CSV, the row."""
    try:
        yield
    except (UserError, ImportError):
        raise
    except Exception as error:  # pyarrow also raises UnicodeDecodeError and ValueError
        text = str(error)
        if d and (cell := CELL.match(text)):
            expected = (
                "a number" if cell[3] == "double" else "a time such as 2026-03-01T12:00:00.050 (years 1678 to 2262)"
            )
            raise UserError(
                f"{path.name}: row {int(cell[2]) - d.skip}: got '{short(cell[4])}' as {short(d.names[int(cell[1])])}, expected "
                f"{expected}; correct it, or leave it empty if nothing was measured."
            ) from None
        if d and (cell := ZONE.match(text)):
            got, expected = ("with", "none") if cell[3] == "no" else ("without", "one")
            raise UserError(
                f"{path.name}: row {int(cell[2]) - d.skip}: got '{short(cell[4])}' {got} a time zone as "
                f"{short(d.names[int(cell[1])])}, expected {expected} as in the rows before; give all times a time zone, or "
                "none."
            ) from None
        if d and (row := ROW.match(text)):
            raise UserError(
                f"{path.name}: row {int(row[1]) - d.skip}: got {row[3]} cells, expected {row[2]} as in the other rows; correct "
                "that row, or remove it if the file was cut off there."
            ) from None
        kind = f"{path.suffix.lower().removeprefix('.')} file" if path.suffix else "frame"
        where = path.name if isinstance(path, Frame) else str(path)
        raise unreadable(error, where, f"a {kind} of numbers, each column with its name; correct it") from None
