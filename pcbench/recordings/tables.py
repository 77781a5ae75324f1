"""A log as tables: `measurements`, `inputs` and `truth` as CSV or Parquet, in a folder or beside each other.

    flight/measurements.parquet   flight/inputs.parquet   flight/truth.parquet
    flight.parquet                flight.inputs.parquet   flight.truth.parquet

Measurements have the columns channel, sampled, arrived, value; inputs and truth t and one column each. A head may say a unit of
time, "sampled [ms]"; seconds otherwise. Channels stand in the order of the numbers in their names, y2 before y10.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pcbench.errors import UserError
from pcbench.recordings import columns, units
from pcbench.recordings.log import Batch, Log, Rows, Table

COLUMNS = ("channel", "sampled", "value")


def opened(path: Path, delay: float | None = None) -> Log:
    """Return a log in tables; `delay` [s] stands for a column `arrived`. Raise UserError where one or a column is missing."""
    measured, beside = _files(path)
    named = {units.parts(head)[0]: head for head in columns.heads(measured)}
    columns.require(measured, list(named), COLUMNS)
    if "arrived" not in named and delay is None:
        raise UserError(
            f"{measured.name}: got no column 'arrived', expected when samples arrived [s]; write the column, "
            "or give --delay."
        )
    if "arrived" in named and delay is not None:
        raise UserError(
            f"{measured.name}: got a column 'arrived' and --delay {delay:g}, expected one of them; leave one out."
        )
    channels = _channels(measured, named["channel"])
    return Log(
        name=measured.name,
        channels=channels,
        measurements=lambda: _measurements(measured, named, channels, delay),
        inputs=_table(beside["inputs"]),
        truth=_table(beside["truth"]),
    )


def _files(path: Path) -> tuple[Path, dict[str, Path | None]]:
    """The files of a log: its measurements, and where there are any inputs and truth."""

    def first(*names: Path) -> Path | None:
        return next((name for name in names if name.is_file()), None)

    if path.is_dir():
        measured = first(*(path / f"measurements{kind}" for kind in columns.KINDS))
        if measured is None:
            raise UserError(
                f"{path}: got a folder without measurements.parquet or measurements.csv, expected one of them; a bag of ROS 2 "
                "needs a TOML that says which topics are channels (pcbench guide logs)."
            )
        return measured, {what: first(*(path / f"{what}{k}" for k in columns.KINDS)) for what in ("inputs", "truth")}
    beside = {what: first(*(path.with_suffix(f".{what}{k}") for k in columns.KINDS)) for what in ("inputs", "truth")}
    return path, beside


def _channels(path: Path, head: str) -> tuple[str, ...]:
    """Every channel's name, in the order of the numbers in them."""
    found: set[str] = set()
    for part in columns.parts(path, [head], [head]):
        found |= set(pc.unique(_words(part.column(0), f"{path.name}: {head}")).to_pylist())
    if not found or None in found:
        raise UserError(
            f"{path.name}: got {'a row without a channel' if found else 'no rows'}, expected samples with the name of their "
            "channel each; mend the file."
        )
    return tuple(sorted((str(name) for name in found), key=natural))


def _words(column: pa.Array, where: str) -> pa.Array:
    column = column.dictionary_decode() if pa.types.is_dictionary(column.type) else column
    try:
        return pc.cast(column, pa.string())
    except pa.ArrowException:
        raise UserError(f"{where}: got {column.type}, expected names of channels; mend the column.") from None


def natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which names stand in the order of the numbers in them."""
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in re.split(r"(\d+)", name) if p]


def _measurements(path: Path, named: dict[str, str], channels: tuple[str, ...], delay: float | None) -> Iterator[Batch]:
    wanted = [named[name] for name in (*COLUMNS, "arrived") if name in named]
    known, row = pa.array(channels), 1
    for part in columns.parts(path, wanted, [named["channel"]]):
        sampled = _seconds(part, named["sampled"], path)
        late = sampled + delay if delay is not None else _seconds(part, named["arrived"], path)
        yield Batch(
            channel=pc.index_in(_words(part.column(named["channel"]), path.name), known)
            .to_numpy(zero_copy_only=False)
            .astype(int),
            sampled=sampled,
            arrived=late,
            value=_number(part, named["value"], path),
            row=np.arange(row, row + len(part)),
        )
        row += len(part)


def _table(path: Path | None) -> Table | None:
    """A table of t and columns of numbers."""
    if path is None:
        return None
    named = {units.parts(head)[0]: head for head in columns.heads(path)}
    columns.require(path, list(named), ["t"])
    names = tuple(name for name in named if name != "t")
    if not names:
        raise UserError(
            f"{path.name}: got the column t alone, expected one more at least; write what stood there at t."
        )

    def read() -> Iterator[Rows]:
        row = 1
        for part in columns.parts(path, list(named.values())):
            values = np.stack([_number(part, named[name], path) for name in names], 1)
            yield Rows(_seconds(part, named["t"], path), values, np.arange(row, row + len(part)))
            row += len(part)

    return Table(names, read)


def _seconds(part: pa.RecordBatch, head: str, path: Path) -> np.ndarray:
    return units.seconds(part.column(head), units.parts(head)[1], f"{path.name}: {head}")


def _number(part: pa.RecordBatch, head: str, path: Path) -> np.ndarray:
    return columns.numbers(part.column(head), f"{path.name}: {head}")
