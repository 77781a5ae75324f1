"""A table that is written as it grows, compressed, so that memory hardly grows with its rows."""

from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pcbench.dataset import columns

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
