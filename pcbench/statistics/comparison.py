"""Pairwise comparison of observers on common random numbers: differences, shares of better runs, p-values. No jax.

p-values are those of the paired t-test (Student's interval of the mean difference excludes 0 if p < .05), with Holm's
correction for several tests. Holm's correction bounds the probability of any false positive in a family of tests under any
dependence. Source: Holm, Scand. J. Stat. 6 (1979), 65-70. The false positive rate of a test is at most 5 % (`test_coverage`)
from 64 runs on if both observers' errors have the same distribution. If their difference has skewness 1.3, it is 5.14 % for 256
runs, 5.7 % for 64 and 6.5 % for 16. If the runs do not vary (no noise) there is no test: p is NaN.

`paired_ratio` gives a ratio of two means with the interval of its logarithm. `add_pairs` and `pair_results` compare all pairs
of observers at a grid point, metric by metric: rows of `pairs`.
"""

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.confidence_intervals import Estimate, Moments, Values, merge, moments, student
from pcbench.statistics.metric_matrix import COMPARED, POOLED, SignalMetric, Stack, keep_columns

SAME = 1e-7  # relative difference below which two metrics of a run are a tie: they are equal up to rounding


class PairStats(NamedTuple):
    """Accumulated comparison of two observers' values [K, n]; counts [K] are over runs in which neither diverged."""

    difference: Moments  # of a - b, over runs in which neither diverged
    wins: NDArray[np.int64]  # a is smaller, and no tie
    ties: NDArray[np.int64]
    only: tuple[int, int]  # runs in which only a diverged, and only b
    neither: int  # runs in which both diverged


def pair_stats(a: Values, b: Values, bad_a: NDArray[np.bool_], bad_b: NDArray[np.bool_], floor: Values) -> PairStats:
    """Return the comparison of values [K, n] of two observers; a difference up to floor [K] is a tie."""
    is_good = ~(bad_a | bad_b)
    a, b = keep_columns(a, is_good), keep_columns(b, is_good)
    difference = a - b
    tolerance = np.maximum(np.abs(a), np.abs(b))
    tolerance *= SAME
    tolerance += floor[:, None]
    ties = (np.abs(difference) <= tolerance).sum(-1)
    wins = (difference < -tolerance).sum(-1)
    only = int((bad_a & ~bad_b).sum()), int((bad_b & ~bad_a).sum())
    return PairStats(moments(difference), wins, ties, only, int((bad_a & bad_b).sum()))


def merge_pairs(a: PairStats, b: PairStats) -> PairStats:
    """Return the comparison of two parts merged."""
    only = a.only[0] + b.only[0], a.only[1] + b.only[1]
    return PairStats(merge(a.difference, b.difference), a.wins + b.wins, a.ties + b.ties, only, a.neither + b.neither)


def stack_metrics(parts: list[PairStats]) -> PairStats:
    """Return comparisons of the same runs over several metrics as one."""
    wins, ties = (np.concatenate([getattr(c, name) for c in parts]) for name in ("wins", "ties"))
    n, *fields = zip(*(c.difference for c in parts), strict=True)
    return parts[0]._replace(difference=Moments(n[0], *map(np.concatenate, fields)), wins=wins, ties=ties)


def paired_t_test(c: PairStats) -> tuple[Estimate, Values, Values]:
    """Return the mean differences, the fractions of runs in which a is better, and the p-values, each [K].

    The fraction is over all runs: a diverged run loses against one that did not diverge. A tie, or two diverged runs, counts
    half.
    """
    from scipy.special import stdtr

    d = student(c.difference)
    runs = d.n + sum(c.only) + c.neither
    better = (c.wins + 0.5 * c.ties + c.only[1] + 0.5 * c.neither) / max(runs, 1)
    better = better if d.n or any(c.only) else np.full(len(c.wins), np.nan)
    varies = (d.n > 1) & (d.se > 0) & (c.ties < d.n)
    t = np.abs(d.mean) / np.where(varies, d.se, 1.0)
    return d, better, np.where(varies, 2 * stdtr(max(d.n - 1, 1), -t), np.nan)


def paired_ratio(a: Values, b: Values) -> Estimate:
    """Return mean(a) / mean(b) [K] of two observers' values [K, n] on the same runs, none of them negative.

    The interval is Student's of the logarithm, by the delta method: its standard error is that of the mean of
    a / mean(a) - b / mean(b). The result is NaN if a mean is 0, and has no interval for one run.
    """
    blank = np.full(len(a), np.nan)
    if not a.shape[-1]:
        return Estimate(0, blank, blank, blank, blank)
    means = [values.mean(-1) for values in (a, b)]
    is_positive = (means[0] > 0) & (means[1] > 0)
    numerator, denominator = (np.where(is_positive, mean, 1.0) for mean in means)
    ratio = np.where(is_positive, numerator / denominator, np.nan)
    log = student(moments(a / numerator[:, None] - b / denominator[:, None]))
    low, high = (ratio * np.exp(end - log.mean) for end in (log.ci_low, log.ci_high))
    return Estimate(log.n, ratio, ratio * log.se, low, high)


def holm(p_values: Values) -> Values:
    """Return Holm's step-down adjustment of p-values [k]; NaN stays NaN and is not counted."""
    out = np.full(len(p_values), np.nan)
    indices = np.flatnonzero(~np.isnan(p_values))
    order = indices[np.argsort(p_values[indices], kind="stable")]
    steps = p_values[order] * (len(order) - np.arange(len(order)))
    out[order] = np.minimum(np.maximum.accumulate(steps), 1.0) if len(order) else steps
    return out


ZERO = 1e-11  # relative to the prior: smaller errors are zero up to rounding
BLOCK = 4 * 4096  # values at a time: intermediate results stay in the cache, measured 2 times faster

VERDICT = ("mean_diff", "se", "ci_low", "ci_high", "prob_a_better", "p_value")
Pair = tuple[str, str]  # labels of two observers


class PairedRuns(NamedTuple):
    """Accumulated comparison of two observers at C grid points, over the metrics [K] of the signals that both estimate."""

    names: list[SignalMetric]
    stats: PairStats  # [C K]


class PairResult(NamedTuple):
    """The rows of two observers at C grid points, one per metric [K]."""

    names: list[SignalMetric]
    n: int
    values: Values  # [C, K, VERDICT]


def add_pairs(
    old: dict[Pair, PairedRuns], stacks: dict[str, Stack], sizes: tuple[float, ...]
) -> dict[Pair, PairedRuns]:
    """Return the comparisons after one more chunk of a grid point's runs; `sizes` are the signals' typical sizes."""
    out = {}
    for pair in itertools.combinations(stacks, 2):
        a, b = (stacks[label] for label in pair)
        names = [(m, i) for i in range(len(sizes)) for m in COMPARED if (m, i) in a.rows and (m, i) in b.rows]
        in_a, in_b = (s.row_indices([s.rows[name] for name in names]) for s in (a, b))
        floor = np.array([ZERO * sizes[i] ** (2 if m in POOLED.values() else 1) for m, i in names])
        floor = np.tile(floor, len(in_a) // max(len(names), 1))
        size = max(1, BLOCK // len(a.diverged))
        blocks = [slice(k, k + size) for k in range(0, len(in_a), size)]
        stats = stack_metrics(
            [pair_stats(a.values[in_a[k]], b.values[in_b[k]], a.diverged, b.diverged, floor[k]) for k in blocks]
        )
        out[pair] = PairedRuns(names, merge_pairs(old[pair].stats, stats) if pair in old else stats)
    return out


def pair_results(comparisons: dict[Pair, PairedRuns]) -> dict[Pair, PairResult]:
    """Return the rows of every pair of observers as columns, for all grid points."""
    out = {}
    for pair, m in comparisons.items():
        d, better, p = paired_t_test(m.stats)
        table = np.stack([*d[1:], better, p], 1)
        out[pair] = PairResult(m.names, d.n, table.reshape(-1, len(m.names), len(VERDICT)))
    return out
