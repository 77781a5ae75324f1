"""Numbers over runs: estimates with their uncertainty, and paired comparisons. NumPy and SciPy, no jax.

The face of the modules below, each one idea:
`estimates` (intervals of means and of fractions, in parts), `quantile_intervals` (order statistics in two passes, and their
intervals), `metric_matrix` (which metrics there are), `aggregate` (rows of `stats`), `comparison` (tests, rows of `pairs`),
`ranking` (who wins on a map), `number_format` (numbers as a person reads them).

All intervals are 95 % over seeds. Diverged runs are counted, never averaged. Where the runs do not vary (no noise) an
interval has no width and there is no test: p is NaN. Runs come in chunks, any number of them; what is kept of them does not
grow with their number (quantiles: hardly, see `quantile_intervals`). The functions of whole arrays [n] are the case of one
chunk.
"""

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import unknown
from pcbench.statistics.aggregate import ESTIMATED, Aggregate, Described, Row, columns, described, rows, see, spread
from pcbench.statistics.comparison import (
    SAME,
    VERDICT,
    ZERO,
    Judged,
    Meeting,
    Pair,
    contest,
    holm,
    meet,
    settled,
    verdict,
    verdicts,
)
from pcbench.statistics.estimates import Z95, Values, moments, positive, reached, root, student, wilson
from pcbench.statistics.metric_matrix import (
    ASKED,
    CHUNK,
    COMPARED,
    OF_RUN,
    POOLED,
    RUN_METRICS,
    Chunks,
    Results,
    joined,
    stack,
)
from pcbench.statistics.quantile_intervals import COLUMNS, QUANTILES, positions, ranks, read

__all__ = [
    "ASKED", "CHUNK", "COLUMNS", "COMPARED", "ESTIMATED", "OF_RUN", "POOLED", "QUANTILES", "RUN_METRICS", "SAME", "SEEN",
    "VERDICT", "Z95", "ZERO",
    "Chunks", "Described", "Judged", "Pair", "Results", "Row", "Values",
    "compare", "compared", "describe", "efficiency", "fraction", "holm", "mean", "pairs", "pooled", "quantiles",
    "size", "summarise", "summary", "summary_of_cells",
]  # fmt: skip

SEEN = 1e-9  # a bound below this part of the prior is zero for every purpose: no efficiency against it


def mean(values: Values) -> Row:
    """Return n, mean, standard error and Student's 95 % interval of values [n]; NaN where there are too few."""
    return columns(student(moments(values[None])))[0]


def size(values: Values) -> Row:
    """Return the same of values [n] that cannot be negative: the interval is Student's of the logarithm of the mean."""
    return columns(positive(moments(values[None])))[0]


def quantiles(values: Values) -> Row:
    """Return the quantiles over runs of values [n] with their 95 % intervals; NaN where there are none."""
    if not len(values):
        return dict.fromkeys(COLUMNS, np.nan)
    where = positions(len(values))
    found = read(where, np.sort(values)[None, ranks(where, len(values))])
    return dict(zip(COLUMNS, found[0].tolist(), strict=True))


def pooled(squares: Values) -> Row:
    """Return the root of the mean of squares [n] with its uncertainty."""
    return columns(root(positive(moments(squares[None]))))[0]


def efficiency(steady_squares: Values, bound: float) -> Row:
    """Return bound / steady_pooled_rmse: 1 attains the bound, 1/5 is five times its rms. Square it for the variance ratio."""
    return columns(reached(np.array([bound]), root(positive(moments(steady_squares[None])))))[0]


def fraction(happened: NDArray[np.bool_]) -> Row:
    """Return the fraction of runs [n] in which something happened, with Wilson's 95 % interval."""
    return columns(wilson(np.array([np.sum(happened)]), len(happened)))[0]


def compare(a: Values, b: Values, bad_a: NDArray[np.bool_], bad_b: NDArray[np.bool_], floor: float = 0.0) -> Row:
    """Compare a metric (smaller is better) of two observers on the same draws [seeds].

    The difference a - b is over runs in which neither diverged. `prob_a_better` is over all runs: a diverged run loses
    against one that did not, and a tie counts half. Values that differ by no more than `floor` are a tie: rounding of zero.
    """
    return verdict(contest(a[None], b[None], bad_a, bad_b, np.array([floor])))[0]


def describe(chunks: Chunks, bounds: dict[str, Values | None]) -> dict[str, list[Row]]:
    """Return by observer a row for every signal (its number) and metric that there is: the table `stats`.

    Of tracking_* only the first signals have a row: those with a set point. `bounds` [signals] are what the efficiency is
    against, NaN where there is none. A second pass over the chunks only where an observer has more runs than are held.
    """
    seen: dict[str, Aggregate] = {}
    for chunk in chunks():
        seen = {label: see(seen.get(label), stack(results)) for label, results in chunk.items()}
    return _described(seen, bounds, chunks)


def pairs(chunks: Chunks, signals: list[str], sizes: tuple[float, ...]) -> list[Row]:
    """Return a row for every pair of observers, signal and metric of one cell: the table `pairs`, less p_holm.

    Only of signals that both estimate; `sizes` are the signals' typical sizes. One pass over the chunks.
    """
    met: dict[Pair, Meeting] = {}
    for chunk in chunks():
        met = meet(met, {label: stack(results) for label, results in chunk.items()}, sizes)
    return verdicts(met, signals)


def summarise(
    chunks: Chunks, bounds: dict[str, Values | None], signals: list[str], sizes: tuple[float, ...]
) -> tuple[dict[str, list[Row]], list[Row]]:
    """Return what `describe` and `pairs` do, from the same passes."""
    seen, met = _seen(chunks, sizes)
    return _described(seen, bounds, chunks), verdicts(met, signals)


def summary(
    chunks: Chunks, bounds: dict[str, Values | None], sizes: tuple[float, ...]
) -> tuple[dict[str, Described], dict[Pair, Judged]]:
    """Return the same of one cell as columns."""
    seen, met = _seen(chunks, sizes)
    return _as_columns(seen, {o: None if b is None else b[None] for o, b in bounds.items()}, chunks), settled(met)


def summary_of_cells(
    cells: list[dict[str, Results]], bounds: dict[str, Values | None], sizes: tuple[float, ...]
) -> tuple[dict[str, Described], dict[Pair, Judged]]:
    """Return the same of several cells with the same observers, rows and seeds, at most CHUNK, in which no run diverged.

    `bounds` are [C, signals]. The bits are those of each cell by itself.
    """
    stacks = {label: joined([stack(results[label]) for results in cells]) for label in cells[0]}
    seen = {label: see(None, s) for label, s in stacks.items()}
    return _as_columns(seen, bounds, lambda: []), settled(meet({}, stacks, sizes))


def _seen(chunks: Chunks, sizes: tuple[float, ...]) -> tuple[dict[str, Aggregate], dict[Pair, Meeting]]:
    seen: dict[str, Aggregate] = {}
    met: dict[Pair, Meeting] = {}
    for chunk in chunks():
        stacks = {label: stack(results) for label, results in chunk.items()}
        seen = {label: see(seen.get(label), s) for label, s in stacks.items()}
        met = meet(met, stacks, sizes)
    return seen, met


def compared(metric: str, where: str) -> str:
    """Return the name of a metric that runs are compared by; raise UserError with the nearest where there is none."""
    if metric not in COMPARED:
        raise unknown(where, "metric of a run", metric, COMPARED)
    return metric


def _as_columns(seen: dict[str, Aggregate], bounds: dict[str, Values | None], chunks: Chunks) -> dict[str, Described]:
    spreads = spread(seen, chunks)
    return {label: described(s, spreads[label], bounds[label]) for label, s in seen.items()}


def _described(seen: dict[str, Aggregate], bounds: dict[str, Values | None], chunks: Chunks) -> dict[str, list[Row]]:
    each = {o: None if b is None else b[None] for o, b in bounds.items()}
    return {label: rows(d) for label, d in _as_columns(seen, each, chunks).items()}
