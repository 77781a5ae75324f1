"""A log as tables: `measurements`, `inputs` and `truth` as CSV or Parquet, in a folder or beside each other.

    flight/measurements.parquet   flight/inputs.parquet   flight/truth.parquet
    flight.parquet                flight.inputs.parquet   flight.truth.parquet

Measurements have the columns channel, sampled, arrived, value; inputs and truth t and one column each. A head may say a unit of
time, "sampled [ms]"; seconds otherwise. Channels stand in the order of the numbers in their names, y2 before y10.

CSV and Parquet of any shape: a column for each channel, or a file with one row a sample; fields are columns.

A run as a log: the tables that `tables` reads.

A simulated run as a log: what its samples brought and when, the input held over every tick, and the true state.
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.recordings import columns, units
from pcbench.recordings.log import Batch, Floats, Log, Rows, Table

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


def fields(
    path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
) -> Iterator[dict[str, Floats]]:
    """Yield parts of columns, [K] each; times in seconds. What is empty is NaN."""
    columns.require(path, columns.heads(path), wanted, f"{where}: {path.name}")
    for part in columns.parts(path, wanted):
        found = {}
        for name in wanted:
            column = part.column(name)
            if name in times:
                found[name] = units.seconds(column, unit or units.parts(name)[1], f"{where}: {name}")
            else:
                found[name] = columns.numbers(column, f"{where}: {name}")
        yield found


def as_tables(
    samples: Batch,
    channels: Sequence[str],
    inputs: tuple[NDArray[Any], NDArray[Any]] | None = None,
    truth: tuple[Sequence[str], NDArray[Any], NDArray[Any]] | None = None,
) -> dict[str, pa.Table]:
    """Return samples, inputs (t [K], u [K, m]) and truth (names, t [K], x [K, n]) as tables, by the names of their files."""
    names = pa.array(channels).take(pa.array(samples.channel))
    lost = np.isnan(samples.arrived)
    columns = [names, pa.array(samples.sampled), pa.array(samples.arrived, mask=lost), pa.array(samples.value)]
    out = {"measurements": pa.table(columns, ["channel", "sampled", "arrived", "value"])}
    if inputs is not None:
        t, u = inputs
        out["inputs"] = _wide(t, u, [f"u{i + 1}" for i in range(u.shape[1])])
    if truth is not None:
        signals, t, x = truth
        out["truth"] = _wide(t, x, signals)
    return out


def _wide(t: NDArray[Any], values: NDArray[Any], names: Sequence[str]) -> pa.Table:
    columns = [t, *(np.ascontiguousarray(v) for v in values.T)]
    return pa.table([pa.array(column) for column in columns], ["t", *names])


def tables_of(
    samples: list[Any], schedule: Any, recording: Any, dt: float, signals: list[str], error: int = 0
) -> dict[str, pa.Table]:
    """Return the tables of a run by name.

    `samples` are (channel, number, taken, arrives [ticks]), with the schedule and the recording they are from. Their times are
    the stamps that observers get, which assume a delay that is `error` ticks too long (`Sample.stamp`). One that was lost,
    or is on its way when the run ends, never arrives. Raises UserError where measuring began before
    tick 0: such samples have measured nothing that a log holds.
    """
    if len(schedule.early):
        raise UserError(
            "--log: got a scenario that measured before t = 0, expected one that begins there; take another."
        )
    last = len(recording.x) - 1
    every = sorted((s for s in samples if s.taken <= last), key=lambda s: (s.taken, s.channel))
    k, slot, channel = np.nonzero(schedule.mask)
    brought = recording.brought[k, slot, channel]
    value = dict(
        zip(zip(channel.tolist(), schedule.number[k, slot, channel].tolist(), strict=True), brought, strict=True)
    )
    batch = Batch(
        channel=np.array([s.channel for s in every], int),
        sampled=np.array([s.stamp(error) * dt for s in every]),
        arrived=np.array([s.arrives * dt if s.arrives <= last else np.nan for s in every]),
        value=np.array([value.get((s.channel, s.number), np.nan) for s in every]),
        row=np.arange(1, len(every) + 1),
    )
    t = np.arange(last + 1) * dt
    channels = [f"y{i + 1}" for i in range(schedule.mask.shape[2])]
    return as_tables(batch, channels, (t, recording.u), (signals, t, recording.x))
