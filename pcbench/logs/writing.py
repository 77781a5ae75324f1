"""A run as a log: the tables that `tables` reads, as Parquet or CSV. Numbers read back as they were."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow import csv

from pcbench.errors import UserError
from pcbench.logs.columns import KINDS
from pcbench.logs.log import Batch


def write(
    folder: str | Path,
    samples: Batch,
    channels: Sequence[str],
    inputs: tuple[NDArray[Any], NDArray[Any]] | None = None,
    truth: tuple[Sequence[str], NDArray[Any], NDArray[Any]] | None = None,
    kind: str = ".parquet",
) -> None:
    """Write samples, inputs (t [K], u [K, m]) and truth (names, t [K], x [K, n]) into a folder, as .parquet or .csv."""
    if kind not in KINDS:
        raise UserError(f"a log as {kind}: expected one of {', '.join(KINDS)}; give one.")
    into = Path(folder)
    into.mkdir(parents=True, exist_ok=True)
    names = pa.array(channels).take(pa.array(samples.channel))
    lost = np.isnan(samples.arrived)
    columns = [names, pa.array(samples.sampled), pa.array(samples.arrived, mask=lost), pa.array(samples.value)]
    _put(into / f"measurements{kind}", pa.table(columns, ["channel", "sampled", "arrived", "value"]))
    if inputs is not None:
        t, u = inputs
        _put(into / f"inputs{kind}", _wide(t, u, [f"u{i + 1}" for i in range(u.shape[1])]))
    if truth is not None:
        signals, t, x = truth
        _put(into / f"truth{kind}", _wide(t, x, signals))


def _wide(t: NDArray[Any], values: NDArray[Any], names: Sequence[str]) -> pa.Table:
    columns = [t, *(np.ascontiguousarray(v) for v in values.T)]
    return pa.table([pa.array(column) for column in columns], ["t", *names])


def _put(path: Path, table: pa.Table) -> None:
    if path.suffix == ".parquet":
        pq.write_table(table, path)
    else:
        csv.write_csv(table, path)
