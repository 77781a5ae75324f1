"""Columns of CSV and Parquet files, a part at a time: pyarrow reads them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import csv

from pcbench.errors import UserError, unknown, unreadable
from pcbench.recordings.log import Floats

NUMBERS = (pa.types.is_floating, pa.types.is_integer, pa.types.is_decimal, pa.types.is_boolean, pa.types.is_null)
KINDS = (".parquet", ".csv")
MANY = 1 << 16  # rows of a part
BLOCK = 1 << 20  # bytes of a part of a CSV file
READ = 1 << 18  # bytes of a column of a Parquet file that are read at once


def heads(path: Path) -> list[str]:
    """Return the heads of a file's columns as they are written; raise UserError where it cannot be read."""
    try:
        if path.suffix.lower() == ".parquet":
            return list(pq.read_schema(path).names)
        with csv.open_csv(path) as file:
            return list(file.schema.names)
    except (OSError, pa.ArrowException) as error:
        raise _unreadable(path, error) from None


def parts(path: Path, names: Sequence[str], words: Sequence[str] = ()) -> Iterator[pa.RecordBatch]:
    """Yield the columns `names` a part at a time; all but those of `words` are numbers. Errors name the file."""
    try:
        if path.suffix.lower() == ".parquet":
            # else a group's whole column is read first
            with pq.ParquetFile(path, buffer_size=READ, pre_buffer=False) as file:
                yield from file.iter_batches(MANY, columns=list(names), use_threads=False)
            return
        types = {name: pa.string() if name in words else pa.float64() for name in names}
        convert = csv.ConvertOptions(column_types=types, include_columns=list(names))
        read = csv.ReadOptions(block_size=BLOCK, use_threads=False)
        with csv.open_csv(path, read_options=read, convert_options=convert) as file:
            yield from file
    except (OSError, pa.ArrowException) as error:
        raise _unreadable(path, error) from None


def numbers(column: pa.Array | pa.ChunkedArray, where: str) -> Floats:
    """Return a column as numbers, NaN where it is empty; raise UserError where it holds something else."""
    kind = column.type
    if not any(holds(kind) for holds in NUMBERS):
        raise UserError(f"{where}: got {kind}, expected numbers; mend the column.")
    return np.asarray(pc.cast(column, pa.float64(), safe=False).to_numpy(zero_copy_only=False), float)


def require(path: Path, there: Sequence[str], wanted: Sequence[str], where: str = "") -> None:
    """Raise UserError for a column that a file lacks."""
    for name in wanted:
        if name not in there:
            raise unknown(where or path.name, "column here", name, there)


def _unreadable(path: Path, error: Exception) -> UserError:
    kind = path.suffix.lower().removeprefix(".")
    return unreadable(error, str(path), f"a {kind} file of numbers under one line of heads; mend the file")
