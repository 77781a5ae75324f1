"""Holm's adjusted p-values of a whole table of pairs, which is known only when its last row is."""

import numpy as np
import pyarrow as pa

from pcbench import statistics
from pcbench.dataset import parquet_io
from pcbench.dataset.parquet_stream import GrowingTable


def adjusted(content: pa.Buffer, about: dict[bytes, bytes]) -> pa.Buffer:
    """Put Holm's adjusted p-values into the rows of pairs: one family a scenario, signal and metric."""
    file = parquet_io.opened(content)
    families: dict[tuple[str, ...], list[float]] = {}
    keys = ["scenario", "signal", "metric"]
    for batch in file.iter_batches(columns=[*keys, "p_value"], use_threads=False):
        for *family, p in zip(*(batch[c].to_pylist() for c in [*keys, "p_value"]), strict=True):
            families.setdefault(tuple(family), []).append(np.nan if p is None else p)
    after = {family: iter(statistics.holm(np.array(p))) for family, p in families.items()}
    out = GrowingTable(about)
    for i in range(file.num_row_groups):
        table = file.read_row_group(i, use_threads=False)
        mine = zip(*(table[c].to_pylist() for c in keys), strict=True)
        column = pa.array([float(next(after[family])) for family in mine], pa.float64(), from_pandas=True)
        target = table.schema.get_field_index("p_holm")
        out.add(table.set_column(target, table.schema.field(target), column))
    return out.content()
