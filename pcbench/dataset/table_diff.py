"""The differences of two tables, and which of them are rounding."""

from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

ROUNDING = 1e-9  # two runs of one seed that differ by less, relatively, differ by rounding only
ZERO = 1e-11  # errors this small, as they are or as a part of the signal's largest, are rounding of zero
ERRORS = ("mae", "rmse", "mse", "max_abs_error", "final_error")
Values = NDArray[np.float64]


class Difference(NamedTuple):
    """The largest differences of two tables' numbers."""

    relative: float
    of_largest: float  # as a part of their signal's largest error: what is left of zero is rounding of that


def agree(a: pa.Table, b: pa.Table) -> bool:
    """Return whether two tables are equal to rounding; also the numbers in a reason are rounded."""
    a, b = (t.select([name for name in t.column_names if name != "reason"]) for t in (a, b))
    unequal = _unequal(a, b)
    return unequal is not None and all(np.allclose(u, v, ROUNDING, ZERO, equal_nan=True) for _, u, v in unequal)


def difference(a: pa.Table, b: pa.Table) -> Difference | None:
    """Return the difference of two tables of runs; None if anything but numbers differs."""
    if (unequal := _unequal(a, b)) is None:
        return None
    worst, size = Difference(0.0, 0.0), _sizes(a)
    for name, *numbers in unequal:
        u, v = map(np.nan_to_num, numbers)
        deviation, larger = np.abs(u - v), np.maximum(np.abs(u), np.abs(v))
        relative = deviation / np.where(larger > 0, larger, 1)
        of_largest = deviation / _in_unit_of(name, size)
        worst = Difference(*map(max, worst, (float(relative.max()), float(of_largest.max()))))
    return worst


def of_one_run(a: pa.Table, b: pa.Table, within: float) -> bool:
    """Return whether two tables contain the same runs: numbers differ at most by `within` times their column's largest.

    An error may differ by this fraction of its signal's largest error, because a remainder of zero is rounding.
    """
    if (unequal := _unequal(a, b)) is None:
        return False
    size = _sizes(a)
    for name, u, v in unequal:
        scale = np.max(np.abs(u), initial=0.0, where=np.isfinite(u))
        if name.removeprefix("steady_") in ERRORS:
            scale = np.maximum(scale, _in_unit_of(name, size))
        same = (u == v) | (np.isnan(u) & np.isnan(v))
        if not np.where(np.isfinite(u) & np.isfinite(v), np.abs(u - v) <= within * scale, same).all():
            return False
    return True


def _unequal(a: pa.Table, b: pa.Table) -> list[tuple[str, Values, Values]] | None:
    """The columns of numbers in which two tables differ; None if anything else differs."""
    if a.schema.names != b.schema.names or len(a) != len(b):
        return None
    pairs = [(name, a[name], b[name]) for name in a.schema.names if not a[name].equals(b[name])]
    if not all(pa.types.is_floating(x.type) and x.null_count == y.null_count for _, x, y in pairs):
        return None
    return [(name, x.to_numpy(), y.to_numpy()) for name, x, y in pairs]


def _in_unit_of(name: str, size: Values) -> Values:
    """The size of errors in the unit of a column."""
    return size**2 if name in ("mse", "steady_mse") else size


def _sizes(table: pa.Table) -> Values:
    """The largest error of the signal of each row; at least 1e-11, because a smaller error counts as zero."""
    peaks = np.fmax(np.nan_to_num(table["max_abs_error"].to_numpy()), ZERO)
    _, signal = np.unique(table["signal"].to_numpy().astype(str), return_inverse=True)
    return np.array([peaks[signal == i].max() for i in range(signal.max() + 1)])[signal]
