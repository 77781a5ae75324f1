"""Parquet tables as bytes, with a digest that detects changes. No jax."""

import hashlib
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from pcbench.errors import UserError

SEAL = b"pcbench.digest"  # the key in a table's metadata
DAMAGE = (pa.ArrowException, OSError, ValueError)  # what pyarrow raises for a damaged file
MAX_BYTES = 2**28  # of a file in memory
MAX_RATIO = 1000  # or this many times the size of the file, if that is more: equal numbers compress well
ROWS = 20_000  # collected before they are written


def encode_table(table: pa.Table) -> pa.Buffer:
    """Return a table as the bytes of a Parquet file with a checksum on every page; equal tables give equal bytes."""
    sink = pa.BufferOutputStream()
    words = [field.name for field in table.schema if not pa.types.is_floating(field.type)]  # numbers hardly repeat
    options: dict[str, Any] = {"use_dictionary": words, "write_statistics": words, "write_page_checksum": True}
    # snappy: 3 ms of 8 less a block than zstd, for a third more bytes
    pq.write_table(table, sink, compression="snappy", **options)
    content = sink.getvalue()
    footer = pq.read_metadata(pa.BufferReader(content))
    has_metadata = (table.schema.metadata or {}).items() <= (footer.metadata or {}).items()
    if (footer.num_rows, footer.num_columns) != table.shape or not has_metadata:
        raise UserError("store: a table read back from its own bytes differs, expected the same; report this.")
    return content


def open_parquet(content: pa.Buffer) -> pq.ParquetFile:
    """Return a Parquet file in memory, which only the calling thread reads, with every page checked.

    If a pyarrow thread releases a Python object while the interpreter ends, the process aborts (apache/arrow #34314).
    Therefore the bytes belong to pyarrow, and its threads are not used. Raises pa.ArrowInvalid if the file's metadata
    claim far more memory than its size; claims of single pages are left to pyarrow.
    """
    file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True, pre_buffer=False)
    footer = file.metadata
    # not the sizes of single columns: pyarrow aborts if a column is damaged
    pages = sum(footer.row_group(i).total_byte_size for i in range(footer.num_row_groups))
    size = max(8 * footer.num_rows * footer.num_columns, pages)
    if size > max(MAX_BYTES, MAX_RATIO * len(content)):
        file.close()
        raise pa.ArrowInvalid(f"{len(content) / 1e6:.3g} MB that take {size / 1e6:.3g} MB in memory")
    return file


def parse_table(content: pa.Buffer) -> pa.Table:
    """Return the rows of a Parquet file in memory; raise one of DAMAGE if it is damaged."""
    with open_parquet(content) as file:
        return file.read(use_threads=False)


def seal_table(table: pa.Table) -> pa.Table:
    """Return a table with the digest of its columns in its metadata, which `unseal_table` checks."""
    return with_metadata(table, {SEAL: digest(table).encode()})


def unseal_table(content: pa.Buffer | None) -> pa.Table | None:
    """Return the rows of a file from `seal_table`; None if it is missing or its rows have changed."""
    try:
        table = None if content is None else parse_table(content)
    except DAMAGE:
        return None
    return table if table is not None and metadata(table).get(SEAL) == digest(table).encode() else None


def metadata(table: pa.Table) -> dict[bytes, bytes]:
    """Return a table's metadata; empty if it has none."""
    return dict(table.schema.metadata or {})


def with_metadata(table: pa.Table, entries: dict[bytes, bytes]) -> pa.Table:
    """Return a table with additional metadata."""
    return table.replace_schema_metadata(metadata(table) | entries)


def with_column(table: pa.Table, name: str, values: pa.Array | ArrayLike) -> pa.Table:
    """Return a table with other values in one column, whose type and metadata stay."""
    field = table.schema.field(name)
    values = values if isinstance(values, pa.Array) else pa.array(values, field.type, from_pandas=True)
    return table.set_column(table.schema.get_field_index(name), field, values)


def digest(table: pa.Table, prefix: bytes = b"", texts: bool = True) -> str:
    """Return the digest of some bytes and of a table's columns, numbers to the bit; texts are optional."""
    out = hashlib.sha256(prefix)
    for field, column in zip(table.schema, table.columns, strict=True):
        kind = f"list<item: {field.type.value_type}>" if pa.types.is_list(field.type) else field.type
        out.update(f"{field.name}:{kind}:{column.null_count}".encode())
        if pa.types.is_floating(field.type) or pa.types.is_integer(field.type):
            out.update(np.ascontiguousarray(column.to_numpy()).tobytes())
        elif texts:
            out.update(_as_text(column).encode())
    return out.hexdigest()[:32]


def _as_text(column: pa.ChunkedArray) -> str:
    """The `repr` of a column's list of values; each different text is formatted once."""
    if not pa.types.is_string(column.type):
        return repr(column.to_pylist())
    codes = column.combine_chunks().dictionary_encode()
    vocabulary = np.array([*map(repr, codes.dictionary.to_pylist()), "None"], object)
    return f"[{', '.join(vocabulary[codes.indices.fill_null(len(vocabulary) - 1).to_numpy()].tolist())}]"


class GrowingTable:
    """A table that is written in compressed parts, at least one; the memory hardly grows with its rows."""

    def __init__(self, about: dict[bytes, bytes]) -> None:
        self.about, self.sink = about, pa.BufferOutputStream()
        self.parts: list[pa.Table] = []
        self.writer: pq.ParquetWriter | None = None  # once there is a schema

    def add(self, table: pa.Table) -> None:
        """Add some rows."""
        self.parts.append(with_metadata(table, self.about))
        if sum(map(len, self.parts)) >= ROWS:
            self._write()

    def content(self) -> pa.Buffer:
        """Return the file's bytes."""
        self._write()
        if self.writer:
            self.writer.close()
        return self.sink.getvalue()

    def _write(self) -> None:
        if self.parts:
            table = pa.concat_tables(self.parts)
            options: dict[str, Any] = {"compression": "zstd", "write_page_checksum": True}
            self.writer = self.writer or pq.ParquetWriter(self.sink, table.schema, **options)
            self.writer.write_table(table)
            self.parts = []
