"""Every two observers of a cell against each other, metric by metric: rows of the table `pairs`. NumPy and SciPy, no jax."""

import itertools
from typing import Any, NamedTuple

import numpy as np

from pcbench.statistics.comparison import Contest, beside, contest, join, judged
from pcbench.statistics.stack import COMPARED, POOLED, SignalMetric, Stack

ZERO = 1e-11  # errors below this part of the prior are zero up to rounding
BLOCK = 4 * 4096  # values at a time: what is computed on the way stays in the cache; measured 2 times faster

Row = dict[str, Any]
Pair = tuple[str, str]  # labels of two observers


class Meeting(NamedTuple):
    """What is kept of two observers: their contest over the metrics [K] of the signals that both estimate."""

    names: list[SignalMetric]
    contest: Contest


def meet(before: dict[Pair, Meeting], stacks: dict[str, Stack], sizes: tuple[float, ...]) -> dict[Pair, Meeting]:
    """Return what is kept after one more chunk of a cell's runs; `sizes` are the signals' typical sizes."""
    out = {}
    for pair in itertools.combinations(stacks, 2):
        a, b = (stacks[label] for label in pair)
        names = [(m, i) for i in range(len(sizes)) for m in COMPARED if (m, i) in a.rows and (m, i) in b.rows]
        floor = np.array([ZERO * sizes[i] ** (2 if m in POOLED.values() else 1) for m, i in names])
        in_a, in_b = (np.array([s.rows[name] for name in names]) for s in (a, b))
        size = max(1, BLOCK // len(a.diverged))
        blocks = [slice(k, k + size) for k in range(0, len(names), size)]
        found = beside(
            [contest(a.values[in_a[k]], b.values[in_b[k]], a.diverged, b.diverged, floor[k]) for k in blocks]
        )
        out[pair] = Meeting(names, join(before[pair].contest, found) if pair in before else found)
    return out


def verdicts(met: dict[Pair, Meeting], signals: list[str]) -> list[Row]:
    """Return a row for every pair of observers, signal and metric."""
    rows = []
    for (a, b), (names, kept) in met.items():
        for (metric, i), row in zip(names, verdict(kept), strict=True):
            rows.append({"observer_a": a, "observer_b": b, "signal": signals[i], "metric": metric} | row)
    return rows


def verdict(c: Contest) -> list[Row]:
    """Return what is known of each metric [K] of a contest."""
    d, better, p = judged(c)
    names = ("mean_diff", "se", "ci_low", "ci_high", "prob_a_better", "p_value")
    table = np.stack([*d[1:], better, p], 1).tolist()
    return [{"n": d.n} | dict(zip(names, row, strict=True)) for row in table]
