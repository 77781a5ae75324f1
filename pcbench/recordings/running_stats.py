"""Numbers that come a part at a time: how many, their mean and range exactly, their distribution from an even selection."""

from typing import NamedTuple

import numpy as np

from pcbench.recordings.log import Floats, Ints

KEPT = 1 << 14  # of a selection: every number until there are more, then every second, every fourth ...


class Spread(NamedTuple):
    """What is known of some numbers, each of which came with a mark beside it."""

    many: int = 0
    total: float = 0.0
    least: float = np.inf
    least_mark: float = np.nan  # of the first such number
    most: float = -np.inf
    most_mark: float = np.nan
    every: int = 1
    kept: Floats = np.zeros((0, 2))  # [at most KEPT, 2] mark and number

    @property
    def mean(self) -> float:
        """The mean, NaN of none."""
        return self.total / self.many if self.many else np.nan

    def quantiles(self, *shares: float) -> list[float]:
        """Return quantiles of the selection, NaN of none."""
        values = np.quantile(self.kept[:, 1], shares) if self.many else np.full(len(shares), np.nan)
        return [float(each) for each in values]

    @property
    def first_mark(self) -> int | None:
        """The mark of the first number, if that is a row; None of none."""
        return int(self.kept[0, 0]) if self.many else None

    @property
    def median(self) -> float:
        """The median of the selection."""
        return self.quantiles(0.5)[0]


def add(before: Spread, marks: Floats | Ints, numbers: Floats) -> Spread:
    """Return what is known with some numbers more; NaN is no number."""
    exists = np.isfinite(numbers)
    marks, numbers = marks[exists], numbers[exists]
    if not numbers.size:
        return before
    first = -before.many % before.every
    kept, every = np.concatenate([before.kept, np.stack([marks, numbers], 1)[first :: before.every]]), before.every
    while len(kept) > KEPT:
        kept, every = kept[::2], 2 * every
    low, high = int(np.argmin(numbers)), int(np.argmax(numbers))
    out = before._replace(
        many=before.many + numbers.size, total=before.total + float(numbers.sum()), every=every, kept=kept
    )
    if numbers[low] < out.least:
        out = out._replace(least=float(numbers[low]), least_mark=float(marks[low]))
    if numbers[high] > out.most:
        out = out._replace(most=float(numbers[high]), most_mark=float(marks[high]))
    return out


def largest(before: Floats, sizes: Floats, *marks: Floats | Ints) -> Floats:
    """Return the hundred rows (size, *marks) with the largest sizes of those before and some more."""
    every = np.concatenate([before, np.stack([sizes, *marks], 1)])
    return every[np.argsort(-every[:, 0], kind="stable")[:100]]


def slope(sums: Floats) -> tuple[float, float]:
    """Return the slope of the line that fits points (x, y) best, and its standard error as if residuals were independent.

    Both are NaN of fewer than three points. `sums` are those of 1, x, y, x x, x y, y y.
    """
    many, x, y, xx, xy, yy = sums.tolist()
    if many < 3 or (xx := xx - x**2 / many) <= 0:
        return np.nan, np.nan
    xy, yy = xy - x * y / many, yy - y**2 / many
    left = max(yy - xy**2 / xx, 0.0) / (many - 2)
    return xy / xx, float(np.sqrt(left / xx))
