"""Running statistics: count, mean and range exactly, the distribution from an evenly thinned selection."""

from typing import NamedTuple

import numpy as np

from pcbench.recordings.log import Floats, Ints

MOST = 1 << 14  # largest selection: every number, then every second, every fourth ...


class RunningStats(NamedTuple):
    """Statistics of numbers, each with a mark such as its row."""

    many: int = 0
    total: float = 0.0
    least: float = np.inf
    least_mark: float = np.nan  # of the first smallest number
    most: float = -np.inf
    most_mark: float = np.nan
    stride: int = 1  # so many numbers per row of the selection
    selection: Floats = np.zeros((0, 2))  # [at most MOST, 2] mark and number

    @property
    def mean(self) -> float:
        """Mean; NaN if empty."""
        return self.total / self.many if self.many else np.nan

    def quantiles(self, *shares: float) -> list[float]:
        """Return quantiles of the selection; NaN if empty."""
        values = np.quantile(self.selection[:, 1], shares) if self.many else np.full(len(shares), np.nan)
        return [float(value) for value in values]

    @property
    def first_mark(self) -> int | None:
        """Row of the first number; None if empty."""
        return int(self.selection[0, 0]) if self.many else None

    @property
    def median(self) -> float:
        """Median of the selection."""
        return self.quantiles(0.5)[0]


def add(before: RunningStats, marks: Floats | Ints, numbers: Floats) -> RunningStats:
    """Return the statistics after further numbers; NaN is ignored."""
    exists = np.isfinite(numbers)
    marks, numbers = marks[exists], numbers[exists]
    if not numbers.size:
        return before
    first, stride = -before.many % before.stride, before.stride
    selection = np.concatenate([before.selection, np.stack([marks, numbers], 1)[first::stride]])
    while len(selection) > MOST:
        selection, stride = selection[::2], 2 * stride
    low, high = int(np.argmin(numbers)), int(np.argmax(numbers))
    out = before._replace(
        many=before.many + numbers.size, total=before.total + float(numbers.sum()), stride=stride, selection=selection
    )
    if numbers[low] < out.least:
        out = out._replace(least=float(numbers[low]), least_mark=float(marks[low]))
    if numbers[high] > out.most:
        out = out._replace(most=float(numbers[high]), most_mark=float(marks[high]))
    return out


def largest(before: Floats, sizes: Floats, *marks: Floats | Ints) -> Floats:
    """Return the hundred rows (size, *marks) with the largest sizes, of those before and further ones."""
    rows = np.concatenate([before, np.stack([sizes, *marks], 1)])
    return rows[np.argsort(-rows[:, 0], kind="stable")[:100]]


def slope(sums: Floats) -> tuple[float, float]:
    """Return the slope of a least-squares line through points (x, y), and its standard error for independent residuals.

    Both are NaN for fewer than three points. `sums` are those of 1, x, y, x x, x y, y y.
    """
    many, x, y, xx, xy, yy = sums.tolist()
    if many < 3 or (xx := xx - x**2 / many) <= 0:
        return np.nan, np.nan
    xy, yy = xy - x * y / many, yy - y**2 / many
    residual_variance = max(yy - xy**2 / xx, 0.0) / (many - 2)
    return xy / xx, float(np.sqrt(residual_variance / xx))
