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
        self.rows: list[dict[str, Any]] = []  # that are to be a table of so ordered columns
        self.order: list[str] = []
        self.writer: Any = None  # a pq.ParquetWriter, once there is a schema

    def add(self, table: pa.Table) -> None:
        """Add some rows."""
        self._gather()
        self._wait(table)

    def _wait(self, table: pa.Table) -> None:
        self.waiting.append(table.replace_schema_metadata((table.schema.metadata or {}) | self.about))
        if sum(map(len, self.waiting)) >= ROWS:
            self._write()

    def add_rows(self, rows: list[dict[str, Any]], order: list[str]) -> None:
        """Add some rows that are no table yet: of many together one is made in the time of one of few."""
        if order != self.order:
            self._gather()
        self.order = order
        self.rows.extend(rows)
        if len(self.rows) >= GATHERED:
            self._gather()

    def content(self) -> pa.Buffer:
        """Return the file's bytes."""
        self._gather()
        self._write()
        self.writer.close()
        return self.sink.getvalue()

    def _gather(self) -> None:
        if self.rows or (self.order and not (self.writer or self.waiting)):
            self._wait(columns.rows_table(self.rows, self.order))
        self.rows = []

    def _write(self) -> None:
        if self.waiting:
            table = pa.concat_tables(self.waiting)
            how = {"compression": "zstd", "write_page_checksum": True}
            self.writer = self.writer or pq.ParquetWriter(self.sink, table.schema, **how)
            self.writer.write_table(table)
            self.waiting = []
