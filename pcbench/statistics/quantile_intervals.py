"""Quantiles over runs with 95 % intervals, from order statistics. NumPy and SciPy, no jax.

The quantile is NumPy's linear one: x_(1) <= ... <= x_(n) interpolated at 1 + (n - 1) q.
The interval is free of the distribution, up to an interpolation between two neighbouring order statistics.
Source: Nyblom, Note on interpolated order statistics, Stat. Probab. Lett. 14 (1992), 129-131; for the median it is
Hettmansperger and Sheather, Confidence intervals based on interpolated order statistics, ibid. 4 (1986), 75-79.

1. Let xi be the q-quantile of a continuous distribution, N = #{i: x_i <= xi} ~ Bin(n, q). Then P(x_(r) <= xi) = P(N >= r).
2. A lower end is a point that lies at or below xi with probability g = 0.975, an upper end one with g = 0.025.
   Take r such that P(N >= r) >= g > P(N >= r + 1): the end lies between x_(r) and x_(r+1), at (1 - w) x_(r) + w x_(r+1).
3. This point is <= xi where N >= r + 1, and where N = r if w (x_(r+1) - xi) <= (1 - w) (xi - x_(r)). The latter has to
   happen with conditional probability a = (g - P(N >= r + 1)) / P(N = r), which depends on the distribution through its
   shape next to xi only. With exponential sides that meet there (density f, xi - x = Exp(f / q), x - xi = Exp(f / (1 - q))),
   given N = r the distances to the next values are xi - x_(r) ~ (q / r) E, x_(r+1) - xi ~ ((1 - q) / (n - r)) E',
   and P(c' E' <= c E) = c / (c + c') with c = (1 - w) q / r, c' = w (1 - q) / (n - r).
4. Hence w / (1 - w) = ((1 - a) / a) q (n - r) / ((1 - q) r): Nyblom's weight.

Where no order statistic lies beyond xi with that probability the interval is open on that side and its end is NaN: an end
of the median needs 6 runs, of p25 and p75 3 on the near side (p25: above) and 13 on the far one, of p05 and p95 2 and 72. The
closed end of such an interval still errs with 2.5 %.
Not claimed: exactness, which step 3 has for its own shape only; for other densities each end errs with 2 to 3.1 %.
Ties (a settling time at the horizon) make N larger, and the interval cover more, unless the distribution function takes
the very value q on a step: there an end errs by up to P(N = r) more.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.distributions import binomial_above
from pcbench.statistics.moments import Values

QUANTILES = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
COLUMNS = tuple(name + end for name in QUANTILES for end in ("", "_low", "_high"))


class Positions(NamedTuple):
    """Where between the sorted values each of COLUMNS [W] lies: after x[rank], by `part` of the way to the next."""

    rank: NDArray[np.int64]  # from 0
    part: Values  # NaN: open


@cache
def positions(n: int) -> Positions:
    """Return the positions of the quantiles and of the ends of their intervals among n > 0 sorted values."""
    q = np.array(list(QUANTILES.values()))
    at = (n - 1) * q
    low, high = _end(n, q, 0.975), _end(n, q, 0.025)
    rank, part = np.stack([np.floor(at), low[0], high[0]], 1), np.stack([at - np.floor(at), low[1], high[1]], 1)
    return Positions(rank.ravel().astype(np.int64), part.ravel())


def ranks(where: Positions, n: int) -> NDArray[np.int64]:
    """Return the ranks [2 W] that `read` needs: those of the positions and the next ones."""
    return np.concatenate([where.rank, np.minimum(where.rank + 1, n - 1)])


def read(where: Positions, found: Values) -> Values:
    """Return the values [K, W] at the positions from those at `ranks` [K, 2 W]; the bits are those of np.quantile."""
    a, b = np.split(found, 2, axis=-1)
    up = b - a
    return np.where(where.part < 0.5, a + up * where.part, b - up * (1 - where.part))


def _end(n: int, q: Values, g: float) -> tuple[NDArray[np.int64], Values]:
    """Rank (from 0) and weight of the point that is at or below the quantiles q with probability g; weight NaN: none."""
    r = _last(n, q, g)
    closed = (r >= 1) & (r < n)
    r = np.where(closed, r, 1)
    beyond, here = binomial_above(r, n, q), binomial_above(r - 1, n, q)  # P(N >= r + 1), P(N >= r)
    # a / (1 - a) of step 3, times (1 - q) r / (q (n - r))
    odds = (g - beyond) * (1 - q) * r / ((here - g) * q * np.maximum(n - r, 1) + np.finfo(float).tiny)
    return r - 1, np.where(closed, 1 / (1 + odds), np.nan)


def _last(n: int, q: Values, g: float) -> NDArray[np.int64]:
    """The largest r in 0 .. n with P(N >= r) >= g, by bisection."""
    low, high = np.zeros(len(q), np.int64), np.full(len(q), n + 1)
    while (high - low > 1).any():
        middle = (low + high) // 2
        enough = binomial_above(middle - 1, n, q) >= g
        low, high = np.where(enough, middle, low), np.where(enough, high, middle)
    return low
