"""Tables that know whether they are as they were written: Parquet as bytes, with a digest. No jax."""

import hashlib
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from pcbench.errors import UserError

SEAL = b"pcbench.digest"  # the key in a table's metadata
DAMAGE = (pa.ArrowException, OSError, ValueError)  # what pyarrow raises where a file is not as it was written
PLAIN = 2**28  # bytes that a file may take in memory
RATIO = 1000  # or so many times its own bytes, if that is more: equal numbers take little in a file
ROWS = 20_000  # that are gathered before they are written


def encode_table(table: pa.Table) -> pa.Buffer:
    """Return a table as the bytes of a Parquet file with a checksum on every page; equal tables give equal bytes."""
    sink = pa.BufferOutputStream()
    words = [field.name for field in table.schema if not pa.types.is_floating(field.type)]  # numbers hardly repeat
    how: dict[str, Any] = {"use_dictionary": words, "write_statistics": words, "write_page_checksum": True}
    pq.write_table(table, sink, compression="snappy", **how)  # 3 ms of 8 less a block than zstd, for a third more bytes
    content = sink.getvalue()
    back = pq.read_metadata(pa.BufferReader(content))
    same = (table.schema.metadata or {}).items() <= (back.metadata or {}).items()
    if (back.num_rows, back.num_columns) != table.shape or not same:
        raise UserError("store: a table read back from its own bytes differs, expected the same; report this.")
    return content


def open_parquet(content: pa.Buffer) -> pq.ParquetFile:
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


def parse_table(content: pa.Buffer) -> pa.Table:
    """Return the rows of a Parquet file in memory; raise one of DAMAGE where it is damaged."""
    with open_parquet(content) as file:
        return file.read(use_threads=False)


def seal_table(table: pa.Table) -> pa.Table:
    """Return a table with the digest of its columns among its metadata, for `unseal_table` to look at."""
    return with_metadata(table, {SEAL: digest(table).encode()})


def unseal_table(content: pa.Buffer | None) -> pa.Table | None:
    """Return the rows of a file that was `seal_table`; None where there is none, or they are not those that were written."""
    try:
        table = None if content is None else parse_table(content)
    except DAMAGE:
        return None
    return table if table is not None and metadata(table).get(SEAL) == digest(table).encode() else None


def metadata(table: pa.Table) -> dict[bytes, bytes]:
    """Return a table's metadata; empty where it has none."""
    return dict(table.schema.metadata or {})


def with_metadata(table: pa.Table, more: dict[bytes, bytes]) -> pa.Table:
    """Return a table with more metadata."""
    return table.replace_schema_metadata(metadata(table) | more)


def with_column(table: pa.Table, name: str, values: pa.Array | ArrayLike) -> pa.Table:
    """Return a table with other values in one of its columns, which keeps its type and what it says of itself."""
    field = table.schema.field(name)
    values = values if isinstance(values, pa.Array) else pa.array(values, field.type, from_pandas=True)
    return table.set_column(table.schema.get_field_index(name), field, values)


def digest(table: pa.Table, begin: bytes = b"", words: bool = True) -> str:
    """Return the digest of a table's columns, of numbers to the bit, after some bytes; with its words or without."""
    out = hashlib.sha256(begin)
    for field, column in zip(table.schema, table.columns, strict=True):
        kind = f"list<item: {field.type.value_type}>" if pa.types.is_list(field.type) else field.type
        out.update(f"{field.name}:{kind}:{column.null_count}".encode())
        if pa.types.is_floating(field.type) or pa.types.is_integer(field.type):
            out.update(np.ascontiguousarray(column.to_numpy()).tobytes())
        elif words:
            out.update(_as_text(column).encode())
    return out.hexdigest()[:32]


def _as_text(column: pa.ChunkedArray) -> str:
    """The `repr` of a column's list of values; of words, which are few, each is written once and looked up."""
    if not pa.types.is_string(column.type):
        return repr(column.to_pylist())
    coded = column.combine_chunks().dictionary_encode()
    vocabulary = np.array([*map(repr, coded.dictionary.to_pylist()), "None"], object)
    return f"[{', '.join(vocabulary[coded.indices.fill_null(len(vocabulary) - 1).to_numpy()].tolist())}]"


class GrowingTable:
    """A table whose rows come in parts, one part at least, written compressed: memory hardly grows with its rows."""

    def __init__(self, about: dict[bytes, bytes]) -> None:
        self.about, self.sink = about, pa.BufferOutputStream()
        self.waiting: list[pa.Table] = []
        self.writer: pq.ParquetWriter | None = None  # once there is a schema

    def add(self, table: pa.Table) -> None:
        """Add some rows."""
        self.waiting.append(with_metadata(table, self.about))
        if sum(map(len, self.waiting)) >= ROWS:
            self._write()

    def content(self) -> pa.Buffer:
        """Return the file's bytes."""
        self._write()
        if self.writer:
            self.writer.close()
        return self.sink.getvalue()

    def _write(self) -> None:
        if self.waiting:
            table = pa.concat_tables(self.waiting)
            how: dict[str, Any] = {"compression": "zstd", "write_page_checksum": True}
            self.writer = self.writer or pq.ParquetWriter(self.sink, table.schema, **how)
            self.writer.write_table(table)
            self.waiting = []
