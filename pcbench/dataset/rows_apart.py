"""How far the numbers of two tables of runs are apart, and what of that is rounding."""

from typing import NamedTuple

import numpy as np
import pyarrow as pa

ROUNDING = 1e-9  # two runs of one seed that differ by less, relatively, differ by rounding only
ZERO = 1e-11  # errors this small, as they are or as a part of the signal's largest, are rounding of zero


class Difference(NamedTuple):
    """How far two tables' numbers are apart at most."""

    relative: float
    of_largest: float  # as a part of their signal's largest error: what is left of zero is rounding of that


def difference(a: pa.Table, b: pa.Table) -> Difference | None:
    """Return how far two tables' numbers are apart; None where they differ in anything else."""
    if a.schema.names != b.schema.names or len(a) != len(b):
        return None
    worst, size = Difference(0.0, 0.0), _sizes(a)
    for name in a.schema.names:
        x, y = a[name], b[name]
        if x.equals(y):
            continue
        if not pa.types.is_floating(x.type) or x.null_count != y.null_count:
            return None
        u, v = (np.nan_to_num(column.to_numpy()) for column in (x, y))
        apart, larger = np.abs(u - v), np.maximum(np.abs(u), np.abs(v))
        whole = size**2 if name in ("mse", "tail_mse") else size
        found = Difference(float((apart / np.where(larger > 0, larger, 1)).max()), float((apart / whole).max()))
        worst = Difference(*map(max, worst, found))
    return worst


def _sizes(table: pa.Table) -> np.ndarray:
    """The largest error of its signal, for every row: at least 1e-11, below which an error is zero."""
    peaks = np.fmax(np.nan_to_num(table["peak"].to_numpy()), ZERO)
    _, signal = np.unique(table["signal"].to_numpy().astype(str), return_inverse=True)
    return np.array([peaks[signal == i].max() for i in range(signal.max() + 1)])[signal]
