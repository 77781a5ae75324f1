"""Quantiles over runs with 95 % intervals, from order statistics. NumPy and SciPy, no jax.

The quantile is NumPy's linear one: x_(1) <= ... <= x_(n) interpolated at 1 + (n - 1) q.
The interval is distribution-free, up to an interpolation between two neighbouring order statistics.
Source: Nyblom, Note on interpolated order statistics, Stat. Probab. Lett. 14 (1992), 129-131. For the median it is
Hettmansperger and Sheather, Confidence intervals based on interpolated order statistics, ibid. 4 (1986), 75-79.

1. Let xi be the q-quantile of a continuous distribution, N = #{i: x_i <= xi} ~ Bin(n, q). Then P(x_(r) <= xi) = P(N >= r).
2. A lower end is a point that is at or below xi with probability g = 0.975, an upper end one with g = 0.025.
   Take r such that P(N >= r) >= g > P(N >= r + 1): the end is between x_(r) and x_(r+1), at (1 - w) x_(r) + w x_(r+1).
3. This point is <= xi if N >= r + 1, and if N = r and w (x_(r+1) - xi) <= (1 - w) (xi - x_(r)). The latter must have the
   conditional probability a = (g - P(N >= r + 1)) / P(N = r), which depends on the distribution only through its
   shape next to xi. With exponential sides that meet there (density f, xi - x = Exp(f / q), x - xi = Exp(f / (1 - q))),
   given N = r the distances to the next values are xi - x_(r) ~ (q / r) E, x_(r+1) - xi ~ ((1 - q) / (n - r)) E',
   and P(c' E' <= c E) = c / (c + c') with c = (1 - w) q / r, c' = w (1 - q) / (n - r).
4. Hence w / (1 - w) = ((1 - a) / a) q (n - r) / ((1 - q) r): Nyblom's weight.

If no order statistic is beyond xi with that probability, the interval is open on that side and its end is NaN. An end of the
median needs 6 runs; of p25 and p75 3 on the near side (p25: above) and 13 on the far one; of p05 and p95 2 and 72. The closed
end of such an interval still errs with 2.5 %.
Not claimed: exactness, which step 3 has for its own shape only. For other densities each end errs with 2 to 3.1 %.
Ties (a settling time equal to the duration) increase N and the coverage, unless the distribution function has the value q on a
step. There an end errs by up to P(N = r) more.

Order statistics of any number of values are exact, from at most two passes over them.
Source: Munro and Paterson, Selection and sorting with limited storage, Theor. Comput. Sci. 12 (1980), 315-323. Here the
splitters come from a first part of the values; runs have independent seeds, so their order carries no information.

Up to MAX_STORED values are stored. With more, some of them become splitters s_1 <= ... <= s_S. The first pass counts the values
below and at each splitter. This locates the value of rank r: at a splitter (ties of a splitter cost nothing more) or between
two. The second pass collects the values there. The result is one of the values for any splitters: parts and their order change
the cost, never a bit.

Memory per row: MAX_STORED values and a part, 3 S numbers, and about 1 / S of all values for each requested gap between
splitters. That is small but not constant (10 million values, 20 gaps: 100,000). If the first parts differ from the rest, one
gap may contain all values.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.confidence_intervals import Values

QUANTILES = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
COLUMNS = tuple(name + end for name in QUANTILES for end in ("", "_low", "_high"))


class Positions(NamedTuple):
    """Positions of COLUMNS [W] among the sorted values: after x[rank], by `part` of the way to the next."""

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
    """Return the ranks [2 W] that `values_at` needs: those of the positions and the next ones."""
    return np.concatenate([where.rank, np.minimum(where.rank + 1, n - 1)])


def values_at(where: Positions, values: Values) -> Values:
    """Return the values [K, W] at the positions from those at `ranks` [K, 2 W]; the bits are those of np.quantile."""
    a, b = np.split(values, 2, axis=-1)
    up = b - a
    return np.where(where.part < 0.5, a + up * where.part, b - up * (1 - where.part))


def _end(n: int, q: Values, g: float) -> tuple[NDArray[np.int64], Values]:
    """Return rank (from 0) and weight of the point at or below the quantiles q with probability g; weight NaN: none."""
    from scipy.special import bdtrc  # bdtrc(k, n, q) = P(N > k)

    r, above = np.zeros(len(q), np.int64), np.full(len(q), n + 1)
    while (above - r > 1).any():  # the largest r in 0 .. n with P(N >= r) >= g, by bisection
        middle = (r + above) // 2
        is_below = bdtrc(middle - 1, n, q) >= g
        r, above = np.where(is_below, middle, r), np.where(is_below, above, middle)
    is_closed = (r >= 1) & (r < n)
    r = np.where(is_closed, r, 1)
    beyond, at_least = bdtrc(r, n, q), bdtrc(r - 1, n, q)  # P(N >= r + 1), P(N >= r)
    # a / (1 - a) of step 3, times (1 - q) r / (q (n - r))
    odds = (g - beyond) * (1 - q) * r / ((at_least - g) * q * np.maximum(n - r, 1) + np.finfo(float).tiny)
    return r - 1, np.where(is_closed, 1 / (1 + odds), np.nan)


MAX_STORED = 4096  # with at most this many values there are no splitters and no second pass
SPLITTERS = 2048

Counts = NDArray[np.int64]


class Order(NamedTuple):
    """The result of the first pass over values [K, n]."""

    n: int
    parts: tuple[Values, ...]  # parts [K, m], sorted; empty once there are splitters
    splitters: Values | None  # [K, S], sorted
    below: Counts  # [K, S] number of values < splitter
    upto: Counts  # [K, S] number of values <= splitter


EMPTY = Order(0, (), None, np.zeros((0, 0), np.int64), np.zeros((0, 0), np.int64))


class Search(NamedTuple):
    """Locations of the requested ranks, by row."""

    splitters: Values  # [K, S]
    gaps: list[NDArray[np.int64]]  # gap j is between splitters j - 1 and j
    rank: NDArray[np.int64]  # [K, R] rank among all values in the row's gaps; -1: at a splitter
    value: Values  # [K, R] the splitter


def add(order: Order, values: Values) -> Order:
    """Return the order after one more part of values [K, m]: the first pass."""
    part = np.sort(values, axis=-1)
    n = order.n + part.shape[-1]
    if order.splitters is not None:
        below, upto = _count(order.splitters, part)
        return order._replace(n=n, below=order.below + below, upto=order.upto + upto)
    parts = (*order.parts, part)
    if n <= MAX_STORED:
        return order._replace(n=n, parts=parts)
    table = np.sort(np.concatenate(parts, axis=-1), axis=-1)
    at = np.linspace(0, n - 1, min(SPLITTERS, n)).astype(np.int64)
    splitters = np.ascontiguousarray(table[:, at])
    return Order(n, (), splitters, *_count(splitters, table))


def is_complete(order: Order) -> bool:
    """Return whether every value is stored, so that no second pass is needed."""
    return order.splitters is None


def seek(order: Order, ranks: NDArray[np.int64]) -> Search:
    """Return the locations of the values of ranks [R], 0 .. n - 1."""
    if order.splitters is None:
        return Search(np.zeros((0, 0)), [], np.zeros((0, 0), np.int64), np.zeros((0, 0)))
    gaps, gap_ranks, values = [], [], []
    for splitters, below, upto in zip(order.splitters, order.below, order.upto, strict=True):
        j = np.searchsorted(upto, ranks, side="right")  # the first splitter with more than `rank` values up to it
        index = np.minimum(j, len(splitters) - 1)
        between = (j == len(splitters)) | (ranks < below[index])
        row_gaps = np.unique(j[between])
        first = np.where(j > 0, upto[j - 1], 0)  # rank of the first value in the gap
        sizes = np.append(below, order.n)[row_gaps] - np.where(row_gaps > 0, upto[row_gaps - 1], 0)
        offset = np.concatenate([[0], np.cumsum(sizes)])[np.searchsorted(row_gaps, j)]  # values in lower gaps
        gaps.append(row_gaps)
        gap_ranks.append(np.where(between, ranks - first + offset, -1))
        values.append(splitters[index])
    return Search(order.splitters, gaps, np.stack(gap_ranks), np.stack(values))


def collect(search: Search, values: Values) -> list[Values]:
    """Return the values in the gaps from each row of values [K, m]: the second pass."""
    rows = []
    for splitters, gaps, row in zip(search.splitters, search.gaps, np.sort(values, axis=-1), strict=True):
        last = len(splitters) - 1
        begin = np.where(gaps > 0, np.searchsorted(row, splitters[gaps - 1], side="right"), 0)
        end = np.where(gaps <= last, np.searchsorted(row, splitters[np.minimum(gaps, last)], side="left"), len(row))
        rows.append(np.concatenate([row[:0], *(row[i:j] for i, j in zip(begin, end, strict=True))]))
    return rows


def select(order: Order, search: Search, ranks: NDArray[np.int64], parts: list[list[Values]]) -> Values:
    """Return the values [K, R] of the ranks, from the results of `collect` for every part."""
    if order.splitters is None:
        table = order.parts[0] if len(order.parts) == 1 else np.sort(np.concatenate(order.parts, axis=-1), axis=-1)
        return table[:, ranks]
    out = search.value.copy()
    for k, rank in enumerate(search.rank):
        inside = rank >= 0
        if inside.any():
            out[k, inside] = np.sort(np.concatenate([part[k] for part in parts]))[rank[inside]]
    return out


def _count(splitters: Values, part: Values) -> tuple[Counts, Counts]:
    """Return how many values of the sorted part [K, m] are below, and up to, each splitter [K, S]."""
    rows = list(zip(part, splitters, strict=True))
    below, upto = (np.stack([np.searchsorted(*row, side) for row in rows]) for side in ("left", "right"))
    return below, upto
