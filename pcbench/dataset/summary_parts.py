"""Closing tables that are written as they grow, compressed, so that memory hardly grows with the number of cells. No jax."""

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pcbench import statistics
from pcbench.dataset import parquet

ROWS = 20_000  # that are gathered before they are written


class Gathered:
    """A table, at least one, whose rows come in parts."""

    def __init__(self, about: dict[bytes, bytes]) -> None:
        self.about, self.sink = about, pa.BufferOutputStream()
        self.waiting: list[pa.Table] = []
        self.writer: Any = None

    def add(self, table: pa.Table) -> None:
        """Add some rows."""
        self.waiting.append(table.replace_schema_metadata((table.schema.metadata or {}) | self.about))
        if sum(map(len, self.waiting)) >= ROWS:
            self._write()

    def content(self) -> pa.Buffer:
        """Return the file's bytes."""
        self._write()
        self.writer.close()
        return self.sink.getvalue()

    def _write(self) -> None:
        if self.waiting:
            table = pa.concat_tables(self.waiting)
            how = {"compression": "zstd", "write_page_checksum": True}
            self.writer = self.writer or pq.ParquetWriter(self.sink, table.schema, **how)
            self.writer.write_table(table)
            self.waiting = []


def adjusted(content: pa.Buffer, about: dict[bytes, bytes]) -> pa.Buffer:
    """Put Holm's adjusted p-values into the rows of pairs: one family a scenario, signal and metric."""
    file = parquet.opened(content)
    families: dict[tuple[str, ...], list[float]] = {}
    keys = ["scenario", "signal", "metric"]
    for batch in file.iter_batches(columns=[*keys, "p_value"], use_threads=False):
        for *family, p in zip(*(batch[c].to_pylist() for c in [*keys, "p_value"]), strict=True):
            families.setdefault(tuple(family), []).append(np.nan if p is None else p)
    after = {family: iter(statistics.holm(np.array(p))) for family, p in families.items()}
    out = Gathered(about)
    for i in range(file.num_row_groups):
        table = file.read_row_group(i, use_threads=False)
        mine = zip(*(table[c].to_pylist() for c in keys), strict=True)
        column = pa.array([float(next(after[family])) for family in mine], pa.float64(), from_pandas=True)
        place = table.schema.get_field_index("p_holm")
        out.add(table.set_column(place, table.schema.field(place), column))
    return out.content()
