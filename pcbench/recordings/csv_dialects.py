"""Detect the form of a text table: encoding, separator, decimal sign, lines before the head, units below it.

All are detected from the first SAMPLE bytes, unless the table [csv] of a TOML sets them. Rows are the last lines with equal
numbers of cells and a number or a time in each. The line above them is the head, also if it is a comment. If that line contains
units, the head is the line above it. A table without a head has the columns 0, 1, ..., or those of a trajectory in TUM format.
"""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field

from pcbench.errors import UserError
from pcbench.signal_names import UNIT

SAMPLE, LINES = 1 << 16, 500  # bytes and lines that are examined
COMMENT = re.compile(r"\s*(#|%|//)\s*")
EMPTY = re.compile(r"\s*((#|%|//).*)?")  # a line that is not a row
ALONE = 0.1  # score of a table of one column, chosen if no separator explains more
SEPARATORS = (";", "\t", ",", "|", " ")
TUM = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
KINDS: dict[str, tuple[re.Pattern[str], pa.DataType]] = {
    "number": (re.compile(r"[+-]?(\d+(\.\d*|,\d+)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(inf|nan)", re.IGNORECASE), pa.float64()),
    "zoned": (re.compile(r"\d{4}-\d\d-\d\d[T ][\d:]+(\.\d+)?(Z|[+-]\d\d(:?\d\d)?)"), pa.timestamp("ns", "UTC")),
    "date": (re.compile(r"\d{4}-\d\d-\d\d([T ][\d:]+(\.\d+)?)?"), pa.timestamp("ns")),
    "worded": (  # a date with an unsupported time zone: its blanks do not separate cells
        re.compile(r"\d{4}-\d\d-\d\d[T ][\d:]+(\.\d+)? ?([A-Za-z][\w/+:-]*|[+-]\d\d(:?\d\d)?)"),
        pa.string(),
    ),
    "clock": (re.compile(r"\d\d:\d\d(:\d\d(\.\d+)?)?"), pa.time64("ns")),
}


class CsvOptions(BaseModel):
    """Options of a CSV file in a TOML; missing ones are detected."""

    model_config = ConfigDict(extra="forbid")
    encoding: str | None = None
    separator: str | None = Field(None, min_length=1, max_length=1)
    decimal: str | None = Field(None, min_length=1, max_length=1)
    head: int | None = Field(None, ge=0, description="number of the line with the names of the columns; 0: none")


CSV_DEFAULTS = CsvOptions()


class Dialect(NamedTuple):
    """How to read a file."""

    encoding: str
    separator: str
    decimal: str
    names: tuple[str, ...]  # of columns, with units if given
    types: tuple[pa.DataType, ...]  # of columns: numbers or times
    skip: int  # lines before the first row


class SeparatorFit(NamedTuple):
    """How well a separator explains the lines of a file: larger is better."""

    share: float  # share of cells in rows that are numbers, times or empty
    rows: int
    separator: str
    first: int  # line of the first row
    n_columns: int


def dialect(path: Path, options: CsvOptions) -> Dialect:
    """Return the dialect of a file; raise UserError if it is not text."""
    with path.open("rb") as file:
        sample = file.read(SAMPLE)
        is_truncated = bool(file.read(1))
    encoding = options.encoding or _encoding(sample)
    text = _decode(sample, encoding, path)
    lines = re.split(r"\r\n|\n|\r", text)
    lines = (lines[:-1] if is_truncated and len(lines) > 1 else lines)[:LINES]
    fits = [_fit_separator(lines, s) for s in ([options.separator] if options.separator else SEPARATORS)]
    fit = max(fits, key=lambda fit: (fit.share, fit.rows, fit.n_columns))
    separator, n_columns = fit.separator, fit.n_columns
    head, first = _head(lines, fit, options.head)
    rows = [_cells(line, separator) for line in lines[first:] if not _is_comment(line)]
    rows = [cells for cells in rows if len(cells) == n_columns]
    columns = list(zip(*rows, strict=True)) or [()] * n_columns
    decimal = options.decimal or ("," if any("," in c and _kind(c) == "number" for row in rows for c in row) else ".")
    if not head:
        head = list(TUM if separator == " " and n_columns == len(TUM) else map(str, range(n_columns)))
    types = tuple(map(_type, columns))
    return Dialect(encoding, separator, decimal, tuple(head), types, first)


def _encoding(sample: bytes) -> str:
    """Return the encoding in which a file's first bytes are valid; every byte is valid in latin-1."""
    for mark, name in ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")):
        if sample.startswith(mark):
            return name
    try:
        codecs.getincrementaldecoder("utf-8")().decode(sample)  # the last character may be cut
        return "utf-8"
    except UnicodeDecodeError:
        return "latin-1"


def _decode(sample: bytes, encoding: str, path: Path) -> str:
    try:
        text = sample.decode(encoding, "ignore").removeprefix("\ufeff")  # the last character may be cut
    except LookupError as error:
        raise UserError(f"{path.name}: encoding: {error}; write another in [csv], such as 'latin-1'.") from None
    if "\0" in text or not text.strip():
        got = "bytes that are no text" if "\0" in text else "an empty file"
        raise UserError(f"{path.name}: got {got}, expected a table as text; export it again.")
    return text


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line."""
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _kind(cell: str) -> str:
    """Return the kind of a cell: a key of KINDS, a word, or empty."""
    return next((k for k, (pattern, _) in KINDS.items() if pattern.fullmatch(cell)), "word") if cell else "nothing"


def _type(cells: tuple[str, ...]) -> pa.DataType:
    """Return the type of a column: that of its first number or time; text if it has words only."""
    kinds = [_kind(cell) for cell in cells]
    return next((KINDS[kind][1] for kind in kinds if kind in KINDS), pa.string() if "word" in kinds else pa.float64())


def _is_comment(line: str) -> bool:
    return bool(COMMENT.match(line))


def _fit_separator(lines: list[str], separator: str) -> SeparatorFit:
    """Return how well a separator explains some lines, and where their rows begin."""
    cells = {i: _cells(line, separator) for i, line in enumerate(lines) if line.strip() and not _is_comment(line)}
    kinds = {i: [_kind(cell) for cell in row] for i, row in cells.items()}
    numbers = {i for i, row in kinds.items() if KINDS.keys() & set(row)}
    counts = Counter(len(kinds[i]) for i in numbers)
    n_columns = max(counts, key=lambda n: (counts[n], n), default=len(next(iter(cells.values()), [])))
    run: list[int] = []
    for i in reversed(kinds):
        if len(kinds[i]) == n_columns and i in numbers:
            run.append(i)
        elif len(kinds[i]) == n_columns and run and "word" in kinds[i]:
            break
    if len(run) > 1 and run[-1] == next(iter(kinds)):  # a head with a number among its names
        below = [{kinds[i][c] for i in run[:-1]} for c in range(n_columns)]
        if any(kind == "word" and "word" not in other for kind, other in zip(kinds[run[-1]], below, strict=True)):
            run.pop()
    row_kinds = [kind for i in run for kind in kinds[i]]
    share = sum(kind != "word" for kind in row_kinds) / max(len(row_kinds), 1)
    first = run[-1] if run else next(iter(cells), -1) + 1
    return SeparatorFit(min(share, 1.0 if n_columns > 1 else ALONE), len(run), separator, first, n_columns)


def _head(lines: list[str], fit: SeparatorFit, number: int | None) -> tuple[list[str], int]:
    """Return the names of the columns, with units if the line below has them, and the line of the first row."""
    if number is not None:
        names = _cells(lines[number - 1], fit.separator) if 0 < number <= len(lines) else []
        return names, max(fit.first, number)
    above = [line for line in lines[: fit.first] if line.strip()][-2:]
    *before, names = [list[str](), *(_cells(COMMENT.sub("", line), fit.separator) for line in above)]
    units = [cell.strip("[]()") for cell in names]
    if len(names) != fit.n_columns:
        return [], fit.first
    head = before[-1] if before and not _is_comment(above[0]) else []
    if len(head) == fit.n_columns and all(not u or (n and UNIT.fullmatch(u)) for n, u in zip(head, units, strict=True)):
        pairs = zip(head, units, strict=True)
        names = [f"{name} [{unit}]" if unit and "[" not in name else name for name, unit in pairs]
    return names, fit.first


def blank_squeezer() -> Callable[[bytes], bytes]:
    """Return a function that replaces each run of blanks in a file by one, in chunks."""
    rest = b""

    def squeeze(chunk: bytes) -> bytes:
        nonlocal rest
        data = rest + bytes(chunk)
        body = data.rstrip(b" \t\r\n")
        rest = data[len(body) :]
        out = re.sub(rb"[ \t]*([\r\n])[ \t]*|[ \t]+", lambda blank: blank[1] or b" ", body)
        return out or (b"\n" if len(chunk) else b"")  # an empty chunk would end the file

    return squeeze
