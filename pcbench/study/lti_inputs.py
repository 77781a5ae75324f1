"""Inputs of a plant in `[lti]`: names, waves, a value for each tick, a table over time, or a CSV file.

input = "sine, square"                                                         names, one for all inputs or one for each
input = {signal = "sine", amplitude = 2.0, frequency = 0.5, offset = 1.0}      or a list of such, one for each input
input = [0.0, 0.5, 1.0]                                                        a value for each tick
input = [[0.0, 1.0], [2.5, -1.0]]                                              rows [t, u1, ...], held until the next
input = "voltage.csv"                                                          columns t, u1, ..., held until the next
"""

import csv
from collections.abc import Iterable
from pathlib import Path

from pcbench.errors import UserError, brief_repr, short, unknown
from pcbench.scenarios.sources import SHAPES, Sources, Table, Wave
from pcbench.signal_names import unit
from pcbench.study import axes
from pcbench.toml_text import TomlTable

ROWS = 200_000  # largest number of rows of a table
PERIODIC = [name for name in SHAPES if name != "step"]


def files_in(table: TomlTable) -> list[str]:
    """Return the keys of a table that name a CSV file."""
    values = {key: table.get(key) for key in ("input", "unknown_input")}
    return [key for key, text in values.items() if isinstance(text, str) and text.strip().lower().endswith(".csv")]


def inline_csv_files(table: TomlTable, where: str, folder: Path | None) -> TomlTable:
    """Return a table with the rows of the CSV files that it names, relative to the study's folder; None: the working folder.

    Raises UserError for a file that cannot be read.
    """
    out = dict(table)
    for key in files_in(table):
        path = (folder or Path()) / table[key].strip()
        try:
            out[key] = _read(path)
        except ValueError as error:
            raise UserError(f"{where}.{key}: got {brief_repr(str(path))}, expected {error}.") from None
    return out


def _read(path: Path) -> list[list[float]]:
    """Return the rows of a CSV file; raise ValueError with the expected content if it is invalid."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            head, *rows = [row for row in csv.reader(file) if row]
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is no table with a head"
        raise ValueError(f"a CSV file that can be read ({reason})") from None
    expected = ["t", *(f"u{i + 1}" for i in range(len(head) - 1))]
    if [name.strip() for name in head] != expected or len(head) < 2:
        raise ValueError("a CSV file whose first line is t,u1 or t,u1,u2 ...")
    if len(rows) > ROWS:
        raise ValueError(f"a CSV file of at most {ROWS:,} rows")
    out: list[list[float]] = []
    for i, row in enumerate(rows):
        try:
            out.append([float(v) for v in row])
        except ValueError:
            row = []
        if len(row) != len(head):
            raise ValueError(f"a CSV file with {len(head)} numbers in line {i + 2}")
    return out


def sources(
    value: object, n_inputs: int, valid: Iterable[str], ticks: tuple[int, float], kind: str, where: str
) -> Sources:
    """Return the sources of `n_inputs` inputs (of a `kind`) as in a scenario; raise UserError for an invalid one.

    `ticks` are their number and length [s]; `valid` are the allowed names.
    """
    if isinstance(value, str):
        return ", ".join(_signal_names(value, valid, n_inputs, kind, where))
    if isinstance(value, dict):
        return (_wave(value, where),)
    if not isinstance(value, list) or not value:
        raise UserError(
            f"{where}: got {brief_repr(value)}, expected a signal's name, a table such as {{signal = 'sine', amplitude = 2.0, "
            "frequency = 0.5}, a value for each tick, rows [t, u], or a CSV file."
        )
    if all(isinstance(entry, dict | str) for entry in value):
        if len(value) not in (1, n_inputs):
            raise UserError(f"{where}: got {len(value)} signals, expected one, or one for each of {n_inputs} {kind}.")
        return tuple(
            _wave(entry, f"{where}[{i}]")
            if isinstance(entry, dict)
            else _signal_names(entry, valid, 1, "input", f"{where}[{i}]")[0]
            for i, entry in enumerate(value)
        )
    return (_table(value, n_inputs, ticks, kind, where),)


def _wave(table: TomlTable, where: str) -> Wave:
    """Return a wave from its table."""
    for key in table:
        if key not in ("signal", *Wave._fields[1:]):
            raise unknown(where, "key of a signal", key, ("signal", *Wave._fields[1:]))
    shape = table.get("signal")
    if shape is None:
        raise UserError(f"{where}.signal is missing; write signal = one of {', '.join(SHAPES)}.")
    if shape not in SHAPES:
        raise unknown(f"{where}.signal", "shape of a signal", str(shape), SHAPES)
    unit_text = table.get("unit", "")
    if not isinstance(unit_text, str):
        raise UserError(f"{where}.unit: got {brief_repr(unit_text)}, expected a text such as 'V'.")
    numbers = {
        key: axes.number(table[key], f"{where}.{key}", 0.0 if key == "frequency" else None)
        for key in ("amplitude", "frequency", "offset", "phase")
        if key in table
    }
    if shape in PERIODIC and not numbers.get("frequency"):
        raise UserError(f"{where}: got a {shape} without a frequency, expected one; write frequency = ..., in Hz.")
    if shape not in PERIODIC and (numbers.get("frequency") or numbers.get("phase")):
        raise UserError(f"{where}: got a {shape} with a frequency or a phase, expected neither; leave them out.")
    return Wave(shape, **numbers, unit=unit_text and unit(unit_text, f"{where}.unit"))


def _table(entries: list[object], n_inputs: int, ticks: tuple[int, float], kind: str, where: str) -> Table:
    """Return a table from a value for each tick, or from rows [t, u1, ...]."""
    count, dt = ticks
    if len(entries) > ROWS:
        raise UserError(
            f"{where}: got {len(entries):,} rows, expected at most {ROWS:,}; use a longer tick, or fewer rows."
        )
    if not any(isinstance(row, list) for row in entries):
        values = [axes.number(v, f"{where}[{i}]", None) for i, v in enumerate(entries)]
        if len(values) not in (count, count + 1):
            raise UserError(
                f"{where}: got {len(values)} numbers, expected {count}, one for each tick of {dt:g} s; write rows [t, u] to "
                "hold a value longer."
            )
        return Table(tuple(i * dt for i in range(len(values))), tuple((v,) for v in values))
    rows = [row for row in entries if isinstance(row, list)]
    for i, row in enumerate(entries):
        if not isinstance(row, list) or len(row) not in (2, n_inputs + 1) or len(row) != len(rows[0]):
            raise UserError(
                f"{where}[{i}]: got {brief_repr(row)}, expected a row of t and {'1' if n_inputs == 1 else f'1 or {n_inputs}'} "
                f"numbers, the same in each: one for all, or one for each of {n_inputs} {kind}."
            )
    numbers = [[axes.number(v, f"{where}[{i}][{j}]", None) for j, v in enumerate(row)] for i, row in enumerate(rows)]
    for i in range(1, len(numbers)):
        if numbers[i][0] <= numbers[i - 1][0]:
            raise UserError(
                f"{where}[{i}]: got t = {numbers[i][0]:g} s after {numbers[i - 1][0]:g} s, expected times that grow; "
                "sort the rows."
            )
    return Table(tuple(row[0] for row in numbers), tuple(tuple(row[1:]) for row in numbers))


def _signal_names(text: str, valid: Iterable[str], n_inputs: int, kind: str, where: str) -> list[str]:
    """Return the names of signals, one or one for each of `n_inputs`."""
    names = [part.strip() for part in text.split(",")]
    for name in names:
        if name not in valid:
            raise unknown(where, "input", short(name), valid)
    columns = len(names) + sum(name.startswith("heater") for name in names)  # a heater signal has two columns
    if columns not in (1, n_inputs):
        raise UserError(f"{where}: got {columns} signals, expected one, or one for each of {n_inputs} {kind}.")
    return names
