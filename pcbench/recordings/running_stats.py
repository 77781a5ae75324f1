"""Numbers that come a part at a time: how many, their mean and range exactly, their distribution from an even selection."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

KEPT = 1 << 14  # of a selection: every number until there are more, then every second, every fourth ...


class Spread(NamedTuple):
    """What is known of some numbers, each of which came with a mark beside it."""

    many: int = 0
    total: float = 0.0
    least: float = np.inf
    most: float = -np.inf
    every: int = 1
    kept: NDArray[Any] = np.zeros((0, 2))  # [at most KEPT, 2] mark and number

    @property
    def mean(self) -> float:
        """The mean, NaN of none."""
        return self.total / self.many if self.many else np.nan

    def quantiles(self, shares: tuple[float, ...]) -> list[float]:
        """Return quantiles of the selection, NaN of none."""
        found = np.quantile(self.kept[:, 1], shares) if self.many else np.full(len(shares), np.nan)
        return [float(each) for each in found]


def add(before: Spread, marks: NDArray[Any], numbers: NDArray[Any]) -> Spread:
    """Return what is known with some numbers more."""
    if not numbers.size:
        return before
    first = -before.many % before.every
    kept = np.concatenate([before.kept, np.stack([marks, numbers], 1)[first :: before.every]])
    every = before.every
    while len(kept) > KEPT:
        kept, every = kept[::2], 2 * every
    return Spread(
        many=before.many + numbers.size,
        total=before.total + float(numbers.sum()),
        least=min(before.least, float(numbers.min())),
        most=max(before.most, float(numbers.max())),
        every=every,
        kept=kept,
    )


def largest(before: NDArray[Any], sizes: NDArray[Any], *marks: NDArray[Any], most: int = 100) -> NDArray[Any]:
    """Return the `most` rows (size, *marks) with the largest sizes of those before and some more."""
    every = np.concatenate([before, np.stack([sizes, *marks], 1)])
    return every[np.argsort(-every[:, 0], kind="stable")[:most]]


class Line(NamedTuple):
    """Sums for the line that fits points (x, y) best."""

    many: int = 0
    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    xy: float = 0.0
    yy: float = 0.0

    def slope(self) -> tuple[float, float]:
        """Return the slope and its standard error as if residuals were independent; NaN of fewer than three points."""
        if self.many < 3:
            return np.nan, np.nan
        xx, xy = self.xx - self.x**2 / self.many, self.xy - self.x * self.y / self.many
        yy = self.yy - self.y**2 / self.many
        if xx <= 0:
            return np.nan, np.nan
        left = max(yy - xy**2 / xx, 0.0) / (self.many - 2)
        return xy / xx, float(np.sqrt(left / xx))


def fit(before: Line, x: NDArray[Any], y: NDArray[Any]) -> Line:
    """Return the sums with some points more."""
    more = Line(x.size, x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), yy=(y * y).sum())
    return Line._make(a + b for a, b in zip(before, more, strict=True))
