"""Every two observers of a cell against each other, metric by metric: rows of the table `pairs`. NumPy and SciPy, no jax."""

import itertools
from typing import Any, NamedTuple

import numpy as np

from pcbench.statistics.comparison import Contest, beside, contest, join, judged
from pcbench.statistics.metric_matrix import COMPARED, POOLED, SignalMetric, Stack
from pcbench.statistics.moments import Values

ZERO = 1e-11  # errors below this part of the prior are zero up to rounding
BLOCK = 4 * 4096  # values at a time: what is computed on the way stays in the cache; measured 2 times faster

VERDICT = ("mean_diff", "se", "ci_low", "ci_high", "prob_a_better", "p_value")
Row = dict[str, Any]
Pair = tuple[str, str]  # labels of two observers


class Meeting(NamedTuple):
    """What is kept of two observers in C cells: their contest over the metrics [K] of the signals that both estimate."""

    names: list[SignalMetric]
    contest: Contest  # [C K]


class Judged(NamedTuple):
    """The rows of two observers in C cells, one a metric [K]."""

    names: list[SignalMetric]
    n: int
    values: Values  # [C, K, VERDICT]


def meet(before: dict[Pair, Meeting], stacks: dict[str, Stack], sizes: tuple[float, ...]) -> dict[Pair, Meeting]:
    """Return what is kept after one more chunk of a cell's runs; `sizes` are the signals' typical sizes."""
    out = {}
    for pair in itertools.combinations(stacks, 2):
        a, b = (stacks[label] for label in pair)
        names = [(m, i) for i in range(len(sizes)) for m in COMPARED if (m, i) in a.rows and (m, i) in b.rows]
        in_a, in_b = (s.every([s.rows[name] for name in names]) for s in (a, b))
        floor = np.array([ZERO * sizes[i] ** (2 if m in POOLED.values() else 1) for m, i in names])
        floor = np.tile(floor, len(in_a) // max(len(names), 1))
        size = max(1, BLOCK // len(a.diverged))
        blocks = [slice(k, k + size) for k in range(0, len(in_a), size)]
        found = beside(
            [contest(a.values[in_a[k]], b.values[in_b[k]], a.diverged, b.diverged, floor[k]) for k in blocks]
        )
        out[pair] = Meeting(names, join(before[pair].contest, found) if pair in before else found)
    return out


def verdicts(met: dict[Pair, Meeting], signals: list[str]) -> list[Row]:
    """Return a row for every pair of observers, signal and metric, of one cell."""
    rows = []
    for (a, b), kept in met.items():
        for (metric, i), row in zip(kept.names, verdict(kept.contest), strict=True):
            rows.append({"observer_a": a, "observer_b": b, "signal": signals[i], "metric": metric} | row)
    return rows


def settled(met: dict[Pair, Meeting]) -> dict[Pair, Judged]:
    """Return the same as columns, of all cells."""
    out = {}
    for pair, kept in met.items():
        n, table = _table(kept.contest)
        out[pair] = Judged(kept.names, n, table.reshape(-1, len(kept.names), len(VERDICT)))
    return out


def verdict(c: Contest) -> list[Row]:
    """Return what is known of each metric [K] of a contest."""
    n, table = _table(c)
    return [{"n": n} | dict(zip(VERDICT, row, strict=True)) for row in table.tolist()]


def _table(c: Contest) -> tuple[int, Values]:
    d, better, p = judged(c)
    return d.n, np.stack([*d[1:], better, p], 1)
