"""How far the numbers of two tables of runs are apart, and what of that is rounding."""

from typing import NamedTuple

import numpy as np
import pyarrow as pa

ROUNDING = 1e-9  # two runs of one seed that differ by less, relatively, differ by rounding only
ZERO = 1e-11  # errors this small, as they are or as a part of the signal's largest, are rounding of zero
ERRORS = (
    "mae",
    "rmse",
    "mse",
    "max_abs_error",
    "final_error",
    "steady_mae",
    "steady_rmse",
    "steady_mse",
    "steady_max_abs_error",
)


class Difference(NamedTuple):
    """How far two tables' numbers are apart at most."""

    relative: float
    of_largest: float  # as a part of their signal's largest error: what is left of zero is rounding of that


def difference(a: pa.Table, b: pa.Table) -> Difference | None:
    """Return how far two tables' numbers are apart; None where they differ in anything else."""
    if (unequal := _unequal(a, b)) is None:
        return None
    worst, size = Difference(0.0, 0.0), _sizes(a)
    for name, *numbers in unequal:
        u, v = map(np.nan_to_num, numbers)
        apart, larger = np.abs(u - v), np.maximum(np.abs(u), np.abs(v))
        whole = _in_unit_of(name, size)
        found = Difference(float((apart / np.where(larger > 0, larger, 1)).max()), float((apart / whole).max()))
        worst = Difference(*map(max, worst, found))
    return worst


def of_one_run(a: pa.Table, b: pa.Table, within: float) -> bool:
    """Say whether two tables are of the same runs: numbers differ by a part `within` of the largest of their column at most.

    An error may differ by that part of its signal's largest error, so that what is left of zero is rounding.
    """
    if (unequal := _unequal(a, b)) is None:
        return False
    size = _sizes(a)
    for name, u, v in unequal:
        scale = np.max(np.abs(u), initial=0.0, where=np.isfinite(u))
        if name in ERRORS:
            scale = np.maximum(scale, _in_unit_of(name, size))
        if not np.where(np.isfinite(u) & np.isfinite(v), np.abs(u - v) <= within * scale, _same(u, v)).all():
            return False
    return True


def _same(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Whether numbers are equal, NaN to NaN."""
    return np.asarray((u == v) | (np.isnan(u) & np.isnan(v)))


def _unequal(a: pa.Table, b: pa.Table) -> list[tuple[str, np.ndarray, np.ndarray]] | None:
    """The columns of numbers in which two tables differ; None where they differ in anything else."""
    if a.schema.names != b.schema.names or len(a) != len(b):
        return None
    both = [(name, a[name], b[name]) for name in a.schema.names if not a[name].equals(b[name])]
    if not all(pa.types.is_floating(x.type) and x.null_count == y.null_count for _, x, y in both):
        return None
    return [(name, x.to_numpy(), y.to_numpy()) for name, x, y in both]


def _in_unit_of(name: str, size: np.ndarray) -> np.ndarray:
    """The size of errors in the unit of a column."""
    return size**2 if name in ("mse", "steady_mse") else size


def _sizes(table: pa.Table) -> np.ndarray:
    """The largest error of its signal, for every row: at least 1e-11, below which an error is zero."""
    peaks = np.fmax(np.nan_to_num(table["max_abs_error"].to_numpy()), ZERO)
    _, signal = np.unique(table["signal"].to_numpy().astype(str), return_inverse=True)
    return np.array([peaks[signal == i].max() for i in range(signal.max() + 1)])[signal]
