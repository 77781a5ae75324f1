"""Where on an axis to look: a range, the values to begin with, and the ones between two. No jax.

Times are whole ticks. Between two values lies their geometric mean where they are of one sign and far apart, and else their
arithmetic one, rounded to as few digits as stay near it.
"""

from math import sqrt
from typing import NamedTuple

FAR = 2.0  # times the smaller, from where on a middle is geometric
PART = 0.05  # of a value: to which precision it is found, unless said otherwise
FLOOR = 0.01  # of the range: no finer than that where the range begins at 0 or below
DIGITS = 15


class Scale(NamedTuple):
    """An axis to be searched."""

    low: float
    high: float
    tick: float = 0.0  # s; 0: any number is a value
    tol: float | None = None  # the precision asked for; None: PART of the value
    also: tuple[float, ...] = ()  # values to begin with besides

    def start(self) -> list[float]:
        """Return the values to begin with: the ends, three between them, and those given."""
        middle = self.between(self.low, self.high)
        found = [self.low, middle, self.high, *self.also]
        if middle is not None:
            found += [self.between(self.low, middle), self.between(middle, self.high)]
        return sorted({v for v in found if v is not None})

    def near(self, a: float, b: float) -> bool:
        """Say whether two values, a < b, are as close as was asked."""
        floor = self.tick or (FLOOR * (self.high - self.low) if self.low <= 0 else 0.0)
        enough = max(PART * max(abs(a), abs(b)), floor) if self.tol is None else self.tol
        return b - a <= enough * (1 + 1e-9) or self.between(a, b) is None

    def between(self, a: float, b: float) -> float | None:
        """Return a value about halfway from a to b, a < b, with few digits; None where there is none between."""
        middle = _middle(a, b)
        first, last = _middle(a, middle), _middle(middle, b)
        for digits in range(1, DIGITS + 1):
            value = self.at(float(f"{middle:.{digits}g}"))
            if first <= value <= last and a < value < b:
                return value
        value = self.at(middle)
        return value if a < value < b and self.at(a) < value < self.at(b) else None

    def at(self, value: float) -> float:
        """Return the nearest value of the axis."""
        return float(f"{round(value / self.tick) * self.tick:.12g}") if self.tick else value


def _middle(a: float, b: float) -> float:
    return sqrt(a * b) if a > 0 and b > FAR * a else (a + b) / 2
