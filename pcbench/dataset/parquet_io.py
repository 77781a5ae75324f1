"""Tables that know whether they are as they were written: Parquet as bytes, with a digest.

A table that is written as it grows, compressed, so that memory hardly grows with its rows.
"""

import hashlib
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pcbench.dataset import columns
from pcbench.errors import UserError

SEAL = b"pcbench.digest"  # the key in a table's metadata
PLAIN = 2**28  # bytes that a file may take in memory
RATIO = 1000  # or so many times its own bytes, if that is more: equal numbers take little in a file


def encoded(table: pa.Table) -> pa.Buffer:
    """Return a table as the bytes of a Parquet file with a checksum on every page; equal tables give equal bytes."""
    sink = pa.BufferOutputStream()
    words = [field.name for field in table.schema if not pa.types.is_floating(field.type)]  # numbers hardly repeat
    how: dict[str, Any] = {"use_dictionary": words, "write_statistics": words, "write_page_checksum": True}
    pq.write_table(table, sink, compression="snappy", **how)  # 3 ms of 8 less a block than zstd, for a third more bytes
    content = sink.getvalue()
    back = pq.read_metadata(pa.BufferReader(content))
    said = (table.schema.metadata or {}).items() <= (back.metadata or {}).items()
    if (back.num_rows, back.num_columns) != table.shape or not said:
        raise UserError("store: a table read back from its own bytes differs, expected the same; report this.")
    return content


def opened(content: pa.Buffer) -> pq.ParquetFile:
    """Return a Parquet file in memory, to be read by the thread that asks, every page checked.

    A thread of pyarrow's own that lets go of one of Python's objects while the interpreter ends aborts the process
    (apache/arrow #34314): the bytes are pyarrow's, and none of its threads is asked. Raises pa.ArrowInvalid if the file says of
    itself that it takes far more memory than its size; what single pages say is left to pyarrow.
    """
    file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True, pre_buffer=False)
    of = file.metadata
    pages = sum(of.row_group(i).total_byte_size for i in range(of.num_row_groups))  # of a damaged column pyarrow aborts
    needed = max(8 * of.num_rows * of.num_columns, pages)
    if needed > max(PLAIN, RATIO * len(content)):
        file.close()
        raise pa.ArrowInvalid(f"{len(content) / 1e6:.3g} MB that take {needed / 1e6:.3g} MB in memory")
    return file


def parsed(content: pa.Buffer) -> pa.Table:
    """Return the rows of a Parquet file in memory; raise what pyarrow raises where it is damaged."""
    with opened(content) as file:
        return file.read(use_threads=False)


def sealed(table: pa.Table) -> pa.Table:
    """Return a table with the digest of its columns among its metadata, for `whole` to look at."""
    return table.replace_schema_metadata({**(table.schema.metadata or {}), SEAL: _digest(table)})


def whole(content: pa.Buffer) -> pa.Table | None:
    """Return the rows of a file that was `sealed`; None where they are not those that were written."""
    try:
        table = parsed(content)
    except (pa.ArrowException, OSError, ValueError):
        return None
    return table if (table.schema.metadata or {}).get(SEAL) == _digest(table) else None


def type_of(kind: pa.DataType) -> str:
    """Return the name of a type; of a list the same whatever Parquet and Arrow call what is in it."""
    return f"list<item: {kind.value_type}>" if pa.types.is_list(kind) else str(kind)


def _digest(table: pa.Table) -> bytes:
    out = hashlib.sha256()
    for field, column in zip(table.schema, table.columns, strict=True):
        out.update(f"{field.name}:{type_of(field.type)}:{column.null_count}".encode())
        number = pa.types.is_floating(field.type) or pa.types.is_integer(field.type)
        out.update(np.ascontiguousarray(column.to_numpy()).tobytes() if number else _said(column).encode())
    return out.hexdigest()[:32].encode()


def _said(column: pa.ChunkedArray) -> str:
    """The `repr` of a column's list of values; of words, which are few, each is written once and looked up."""
    if not pa.types.is_string(column.type):
        return repr(column.to_pylist())
    found = column.combine_chunks().dictionary_encode()
    known = np.array([*map(repr, found.dictionary.to_pylist()), "None"], object)
    return f"[{', '.join(known[found.indices.fill_null(len(known) - 1).to_numpy()].tolist())}]"


ROWS = 20_000  # that are gathered before they are written
GATHERED = 2_000  # that are gathered before they are a table


class GrowingTable:
    """A table whose rows come in parts, one part at least."""

    def __init__(self, about: dict[bytes, bytes]) -> None:
        self.about, self.sink = about, pa.BufferOutputStream()
        self.waiting: list[pa.Table] = []
        self.columns: dict[str, list[Any]] = {}  # of rows that are to be a table
        self.writer: Any = None  # a pq.ParquetWriter, once there is a schema

    def add(self, table: pa.Table) -> None:
        """Add some rows."""
        self._gather()
        self._wait(table)

    def _wait(self, table: pa.Table) -> None:
        self.waiting.append(table.replace_schema_metadata((table.schema.metadata or {}) | self.about))
        if sum(map(len, self.waiting)) >= ROWS:
            self._write()

    def add_columns(self, more: dict[str, list[Any]]) -> None:
        """Add some rows, by column, that are no table yet: of many together one is made in the time of one of few."""
        if list(more) != list(self.columns):
            self._gather()
            self.columns = {name: [] for name in more}
        for name, values in more.items():
            self.columns[name].extend(values)
        if len(self.columns["study"]) >= GATHERED:
            self._gather()

    def content(self) -> pa.Buffer:
        """Return the file's bytes."""
        self._gather()
        self._write()
        self.writer.close()
        return self.sink.getvalue()

    def _gather(self) -> None:
        if self.columns and (self.columns["study"] or not (self.writer or self.waiting)):
            self._wait(columns.with_intervals(columns.table(self.columns)))
        self.columns = {name: [] for name in self.columns}

    def _write(self) -> None:
        if self.waiting:
            table = pa.concat_tables(self.waiting)
            how = {"compression": "zstd", "write_page_checksum": True}
            self.writer = self.writer or pq.ParquetWriter(self.sink, table.schema, **how)
            self.writer.write_table(table)
            self.waiting = []
