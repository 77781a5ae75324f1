"""Statistics over runs: estimates with their uncertainty, and paired comparisons. NumPy and SciPy, no jax.

- `confidence_intervals`: intervals of means and of fractions, from data in parts
- `quantile_intervals`: order statistics in two passes, and their intervals
- `metric_matrix`: the metrics of runs
- `aggregate`: the rows of `stats`
- `comparison`: tests, and the rows of `pairs`
- `ranking`: the best observer at a grid point
- `number_format`: numbers as text

All intervals are 95 % over seeds. Diverged runs are counted, never averaged. If runs do not vary (no noise), an interval has no
width and there is no test: p is NaN. Runs come in chunks of any number. Memory does not grow with their number, except slightly
for quantiles (see `quantile_intervals`).
"""

from pcbench.errors import unknown
from pcbench.statistics.aggregate import (
    ESTIMATED,
    Aggregate,
    ObserverSummary,
    Row,
    accumulate,
    columns,
    quantile_rows,
    summarize_observer,
)
from pcbench.statistics.comparison import (
    SAME,
    VERDICT,
    ZERO,
    Pair,
    PairedRuns,
    PairResult,
    add_pairs,
    holm,
    pair_results,
)
from pcbench.statistics.confidence_intervals import Z95, Values, moments, positive, student
from pcbench.statistics.metric_matrix import (
    CHUNK,
    COMPARED,
    OF_RUN,
    OPTIONAL,
    POOLED,
    RUN_METRICS,
    Chunks,
    Results,
    join_stacks,
    stack,
)
from pcbench.statistics.quantile_intervals import COLUMNS, QUANTILES

__all__ = [
    "CHUNK",
    "COLUMNS",
    "COMPARED",
    "ESTIMATED",
    "OF_RUN",
    "OPTIONAL",
    "POOLED",
    "QUANTILES",
    "RUN_METRICS",
    "SAME",
    "VERDICT",
    "Z95",
    "ZERO",
    "ZERO_BOUND",
    "Chunks",
    "ObserverSummary",
    "Pair",
    "PairResult",
    "Results",
    "Row",
    "Values",
    "holm",
    "mean",
    "require_metric",
    "size",
    "summary",
    "summary_of_cells",
]  # fmt: skip

ZERO_BOUND = 1e-9  # relative to the prior: a smaller bound counts as zero, and gives no efficiency


def mean(values: Values) -> Row:
    """Return n, mean, standard error and Student's 95 % interval of values [n]; NaN if there are too few."""
    return columns(student(moments(values[None])))[0]


def size(values: Values) -> Row:
    """Return the same for values [n] that cannot be negative; the interval is Student's of the logarithm of the mean."""
    return columns(positive(moments(values[None])))[0]


def summary(
    chunks: Chunks, bounds: dict[str, Values | None], sizes: tuple[float, ...]
) -> tuple[dict[str, ObserverSummary], dict[Pair, PairResult]]:
    """Return the columns of `stats` by observer, and of `pairs` (without p_holm) by pair of observers, for one grid point.

    `bounds` [signals] are the Kalman bounds for the efficiency, NaN: none. `sizes` are the signals' typical sizes. There is a
    second pass over the chunks only if an observer has more runs than are stored.
    """
    aggregates: dict[str, Aggregate] = {}
    comparisons: dict[Pair, PairedRuns] = {}
    for chunk in chunks():
        stacks = {label: stack(results) for label, results in chunk.items()}
        aggregates = {label: accumulate(aggregates.get(label), s) for label, s in stacks.items()}
        comparisons = add_pairs(comparisons, stacks, sizes)
    of_cell = {o: None if b is None else b[None] for o, b in bounds.items()}
    return _columns(aggregates, of_cell, chunks), pair_results(comparisons)


def summary_of_cells(
    cells: list[dict[str, Results]], bounds: dict[str, Values | None], sizes: tuple[float, ...]
) -> tuple[dict[str, ObserverSummary], dict[Pair, PairResult]]:
    """Return the same for several grid points with equal observers, rows and seeds, at most CHUNK, if no run diverged.

    `bounds` are [C, signals]. The results have the same bits as those of each grid point alone.
    """
    stacks = {label: join_stacks([stack(results[label]) for results in cells]) for label in cells[0]}
    aggregates = {label: accumulate(None, s) for label, s in stacks.items()}
    return _columns(aggregates, bounds, lambda: []), pair_results(add_pairs({}, stacks, sizes))


def _columns(
    aggregates: dict[str, Aggregate], bounds: dict[str, Values | None], chunks: Chunks
) -> dict[str, ObserverSummary]:
    spreads = quantile_rows(aggregates, chunks)
    return {label: summarize_observer(s, spreads[label], bounds[label]) for label, s in aggregates.items()}


def require_metric(metric: str, where: str) -> str:
    """Return a metric by which runs are compared; raise UserError with the nearest name if there is none."""
    if metric not in COMPARED:
        raise unknown(where, "metric of a run", metric, COMPARED)
    return metric
