"""Mean and sum of squares of values that come in parts, for many rows at once. NumPy, no jax.

Parts are merged without cancellation, after Chan, Golub, LeVeque, Am. Stat. 37 (1983), 242-247:

    d = mean_b - mean_a,   mean = mean_a + d n_b / n,   m2 = m2_a + m2_b + d^2 n_a n_b / n.

A row whose values are all equal keeps that value and m2 = 0 exactly, in whatever parts it came.
Merging is associative up to rounding only: who wants the same bits merges the same parts in the same order.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


class Moments(NamedTuple):
    """What is kept of values [K, n]: all but n are [K]."""

    n: int
    mean: Values  # 0 where n = 0
    m2: Values  # sum of (value - mean)^2
    low: Values  # least value; inf where n = 0
    high: Values  # largest value


def moments(values: Values) -> Moments:
    """Return the moments of the rows of values [K, n]; NaN in a row stays in that row."""
    x = np.ascontiguousarray(values, dtype=np.float64)  # a row's sum has the same bits however it lay in memory
    n = x.shape[-1]
    centre = x.sum(-1) / max(n, 1)
    apart = x - centre[:, None]
    m2 = np.square(apart, out=apart).sum(-1)
    return _exact(Moments(n, centre, m2, x.min(-1, initial=np.inf), x.max(-1, initial=-np.inf)))


def merge(a: Moments, b: Moments) -> Moments:
    """Return the moments of two parts [K] together."""
    n = a.n + b.n
    d, share = b.mean - a.mean, b.n / max(n, 1)
    m2 = a.m2 + b.m2 + d * d * (a.n * share)
    return _exact(Moments(n, a.mean + d * share, m2, np.minimum(a.low, b.low), np.maximum(a.high, b.high)))


def _exact(m: Moments) -> Moments:
    """Rows that do not vary, without the rounding of a sum."""
    same = m.low == m.high
    return m._replace(mean=np.where(same, m.low, m.mean), m2=np.where(same, 0.0, m.m2))
