"""Order statistics of any number of values, exact, from at most two passes over them. NumPy, no jax.

Source: Munro and Paterson, Selection and sorting with limited storage, Theor. Comput. Sci. 12 (1980), 315-323; here with
splitters from a first part of the values, which are runs of independent seeds, so that their order tells nothing.

While the values are few they are held. Then some of those held become splitters s_1 <= ... <= s_S, and the first pass counts
how many values lie below and at each. So it is known where the value of rank r is: at a splitter (ties of a splitter cost
nothing more) or between two of them, and the second pass collects what lies there. The result is one of the values
whatever the splitters are: parts and their order change the cost, never a bit.

Memory per row: HELD values and a part, 3 S numbers, and about 1 / S of all values for each gap between splitters that is
asked for: not constant but small (10 million values, 20 gaps: 100,000). Where no value is a splitter's, as when the first
parts are unlike the rest, a gap may hold them all.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.moments import Values

HELD = 4096  # with no more values than this there are no splitters and no second pass
SPLITTERS = 2048

Counts = NDArray[np.int64]


class Order(NamedTuple):
    """What the first pass keeps of values [K, n]."""

    n: int
    held: tuple[Values, ...]  # parts [K, m], sorted; none once there are splitters
    splitters: Values | None  # [K, S], sorted
    below: Counts  # [K, S] how many values are < splitter
    upto: Counts  # [K, S] how many are <= splitter


EMPTY = Order(0, (), None, np.zeros((0, 0), np.int64), np.zeros((0, 0), np.int64))


class Search(NamedTuple):
    """Where the ranks asked for are, by row."""

    splitters: Values  # [K, S]
    gaps: list[NDArray[np.int64]]  # gap j lies between splitters j - 1 and j
    rank: NDArray[np.int64]  # [K, R] rank among all values in the row's gaps; -1: at a splitter
    value: Values  # [K, R] the splitter


def add(order: Order, values: Values) -> Order:
    """Return the order with the rows of values [K, m] counted in: the first pass."""
    part = np.sort(values, axis=-1)
    n = order.n + part.shape[-1]
    if order.splitters is not None:
        below, upto = _count(order.splitters, part)
        return order._replace(n=n, below=order.below + below, upto=order.upto + upto)
    held = (*order.held, part)
    if n <= HELD:
        return order._replace(n=n, held=held)
    whole = np.sort(np.concatenate(held, axis=-1), axis=-1)
    at = np.linspace(0, n - 1, min(SPLITTERS, n)).astype(np.int64)
    splitters = np.ascontiguousarray(whole[:, at])
    return Order(n, (), splitters, *_count(splitters, whole))


def settled(order: Order) -> bool:
    """Return whether every value is held: there is no need of a second pass."""
    return order.splitters is None


def seek(order: Order, ranks: NDArray[np.int64]) -> Search:
    """Return where the values of ranks [R], 0 .. n - 1, have to be looked for."""
    if order.splitters is None:
        return Search(np.zeros((0, 0)), [], np.zeros((0, 0), np.int64), np.zeros((0, 0)))
    gaps, positions, values = [], [], []
    for splitters, below, upto in zip(order.splitters, order.below, order.upto, strict=True):
        j = np.searchsorted(upto, ranks, side="right")  # the first splitter with more than `rank` values up to it
        at = np.minimum(j, len(splitters) - 1)
        between = (j == len(splitters)) | (ranks < below[at])
        mine = np.unique(j[between])
        first = np.where(j > 0, upto[j - 1], 0)  # rank of the first value in the gap
        sizes = np.append(below, order.n)[mine] - np.where(mine > 0, upto[mine - 1], 0)
        before = np.concatenate([[0], np.cumsum(sizes)])[np.searchsorted(mine, j)]  # values in gaps further down
        gaps.append(mine)
        positions.append(np.where(between, ranks - first + before, -1))
        values.append(splitters[at])
    return Search(order.splitters, gaps, np.stack(positions), np.stack(values))


def collect(sought: Search, values: Values) -> list[Values]:
    """Return from each row of values [K, m] those in the gaps: the second pass."""
    found = []
    for splitters, gaps, row in zip(sought.splitters, sought.gaps, np.sort(values, axis=-1), strict=True):
        last = len(splitters) - 1
        begin = np.where(gaps > 0, np.searchsorted(row, splitters[gaps - 1], side="right"), 0)
        end = np.where(gaps <= last, np.searchsorted(row, splitters[np.minimum(gaps, last)], side="left"), len(row))
        found.append(np.concatenate([row[:0], *(row[i:j] for i, j in zip(begin, end, strict=True))]))
    return found


def select(order: Order, sought: Search, ranks: NDArray[np.int64], parts: list[list[Values]]) -> Values:
    """Return the values [K, R] of the ranks, from what `collect` found in every part."""
    if order.splitters is None:
        whole = order.held[0] if len(order.held) == 1 else np.sort(np.concatenate(order.held, axis=-1), axis=-1)
        return whole[:, ranks]
    out = sought.value.copy()
    for k, rank in enumerate(sought.rank):
        inside = rank >= 0
        if inside.any():
            out[k, inside] = np.sort(np.concatenate([part[k] for part in parts]))[rank[inside]]
    return out


def _count(splitters: Values, part: Values) -> tuple[Counts, Counts]:
    """How many of the sorted part [K, m] are below, and up to, each splitter [K, S]."""
    rows = list(zip(part, splitters, strict=True))
    return np.stack([np.searchsorted(*row, "left") for row in rows]), np.stack(
        [np.searchsorted(*row, "right") for row in rows]
    )
