"""A run as a log: the tables that `tables` reads."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench.recordings.log import Batch


def as_tables(
    samples: Batch,
    channels: Sequence[str],
    inputs: tuple[NDArray[Any], NDArray[Any]] | None = None,
    truth: tuple[Sequence[str], NDArray[Any], NDArray[Any]] | None = None,
) -> dict[str, pa.Table]:
    """Return samples, inputs (t [K], u [K, m]) and truth (names, t [K], x [K, n]) as tables, by the names of their files."""
    names = pa.array(channels).take(pa.array(samples.channel))
    lost = np.isnan(samples.arrived)
    columns = [names, pa.array(samples.sampled), pa.array(samples.arrived, mask=lost), pa.array(samples.value)]
    out = {"measurements": pa.table(columns, ["channel", "sampled", "arrived", "value"])}
    if inputs is not None:
        t, u = inputs
        out["inputs"] = _wide(t, u, [f"u{i + 1}" for i in range(u.shape[1])])
    if truth is not None:
        signals, t, x = truth
        out["truth"] = _wide(t, x, signals)
    return out


def _wide(t: NDArray[Any], values: NDArray[Any], names: Sequence[str]) -> pa.Table:
    columns = [t, *(np.ascontiguousarray(v) for v in values.T)]
    return pa.table([pa.array(column) for column in columns], ["t", *names])
