"""Numbers over runs: estimates with their uncertainty, and paired comparisons. NumPy and SciPy, no jax.

The face of the modules below, each one idea:
`confidence_intervals` (of means and of fractions, in parts), `quantile_intervals` (order statistics in two passes, and their
intervals), `metric_matrix` (which metrics there are), `aggregate` (rows of `stats`), `comparison` (tests, rows of `pairs`),
`ranking` (who wins on a map), `number_format` (numbers as a person reads them).

All intervals are 95 % over seeds. Diverged runs are counted, never averaged. Where the runs do not vary (no noise) an
interval has no width and there is no test: p is NaN. Runs come in chunks, any number of them; what is kept of them does not
grow with their number (quantiles: hardly, see `quantile_intervals`).
"""

from pcbench.errors import unknown
from pcbench.statistics.aggregate import (
    ESTIMATED,
    Aggregate,
    ObserverSummary,
    Row,
    columns,
    see,
    spread,
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
    ASKED,
    CHUNK,
    COMPARED,
    OF_RUN,
    POOLED,
    RUN_METRICS,
    Chunks,
    Results,
    join_stacks,
    stack,
)
from pcbench.statistics.quantile_intervals import COLUMNS, QUANTILES

__all__ = [
    "ASKED",
    "CHUNK",
    "COLUMNS",
    "COMPARED",
    "ESTIMATED",
    "OF_RUN",
    "POOLED",
    "QUANTILES",
    "RUN_METRICS",
    "SAME",
    "SEEN",
    "VERDICT",
    "Z95",
    "ZERO",
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

SEEN = 1e-9  # a bound below this part of the prior is zero for every purpose: no efficiency against it


def mean(values: Values) -> Row:
    """Return n, mean, standard error and Student's 95 % interval of values [n]; NaN where there are too few."""
    return columns(student(moments(values[None])))[0]


def size(values: Values) -> Row:
    """Return the same of values [n] that cannot be negative: the interval is Student's of the logarithm of the mean."""
    return columns(positive(moments(values[None])))[0]


def summary(
    chunks: Chunks, bounds: dict[str, Values | None], sizes: tuple[float, ...]
) -> tuple[dict[str, ObserverSummary], dict[Pair, PairResult]]:
    """Return the columns of `stats` by observer, and of `pairs` (less p_holm) by pair of observers, of one cell.

    `bounds` [signals] are what the efficiency is against, NaN where there is none; `sizes` are the signals' typical sizes. A
    second pass over the chunks only where an observer has more runs than are held.
    """
    seen: dict[str, Aggregate] = {}
    met: dict[Pair, PairedRuns] = {}
    for chunk in chunks():
        stacks = {label: stack(results) for label, results in chunk.items()}
        seen = {label: see(seen.get(label), s) for label, s in stacks.items()}
        met = add_pairs(met, stacks, sizes)
    return _columns(seen, {o: None if b is None else b[None] for o, b in bounds.items()}, chunks), pair_results(met)


def summary_of_cells(
    cells: list[dict[str, Results]], bounds: dict[str, Values | None], sizes: tuple[float, ...]
) -> tuple[dict[str, ObserverSummary], dict[Pair, PairResult]]:
    """Return the same of several cells with the same observers, rows and seeds, at most CHUNK, in which no run diverged.

    `bounds` are [C, signals]. The bits are those of each cell by itself.
    """
    stacks = {label: join_stacks([stack(results[label]) for results in cells]) for label in cells[0]}
    seen = {label: see(None, s) for label, s in stacks.items()}
    return _columns(seen, bounds, lambda: []), pair_results(add_pairs({}, stacks, sizes))


def _columns(
    seen: dict[str, Aggregate], bounds: dict[str, Values | None], chunks: Chunks
) -> dict[str, ObserverSummary]:
    spreads = spread(seen, chunks)
    return {label: summarize_observer(s, spreads[label], bounds[label]) for label, s in seen.items()}


def require_metric(metric: str, where: str) -> str:
    """Return the name of a metric that runs are compared by; raise UserError with the nearest where there is none."""
    if metric not in COMPARED:
        raise unknown(where, "metric of a run", metric, COMPARED)
    return metric
