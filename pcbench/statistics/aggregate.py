"""Statistics of each observer's runs at a grid point, accumulated in chunks: rows of `stats`. NumPy and SciPy, no jax."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics import consistency, quantile_intervals
from pcbench.statistics.confidence_intervals import (
    Estimate,
    Moments,
    Values,
    merge,
    moments,
    positive,
    rms_efficiency,
    root,
    student,
    wilson,
)
from pcbench.statistics.metric_matrix import (
    POOLED,
    RUN_METRICS,
    SIGNED,
    Chunks,
    SignalMetric,
    Stack,
    keep_columns,
    stack,
)
from pcbench.statistics.quantile_intervals import COLUMNS, positions, ranks, values_at

Row = dict[str, Any]  # of stats or pairs, by column
DESCRIBED = (
    *RUN_METRICS,
    *POOLED,
    "divergence_rate",
    "unsettled_rate",
    "rms_efficiency",
    *consistency.BANDS.values(),
    *consistency.INSIDE,
)
ESTIMATED = Estimate._fields[1:]


class Aggregate(NamedTuple):
    """Accumulated statistics of one observer's runs at C grid points; diverged runs are only counted."""

    rows: dict[SignalMetric, int]
    moments: Moments  # [C K]
    order: quantile_intervals.Order  # [C K]
    diverged: int
    unsettled: NDArray[np.int64]  # [C signals]
    inside: NDArray[np.int64]  # [3, C states] within one, two, three sigma, for an observer with a covariance
    innovations: Moments | None  # [3 C] of normalized squares, their degrees of freedom, and the difference

    @property
    def cells(self) -> int:
        """Return C."""
        return len(self.moments.mean) // len(self.rows)


class ObserverSummary(NamedTuple):
    """The rows of one observer at C grid points, R of each."""

    names: list[SignalMetric]  # [R]
    n: NDArray[np.int64]  # [R]
    diverged: int  # at each grid point
    values: Values  # [C, R, COLUMNS of an estimate and of quantiles]
    exists: NDArray[np.bool_]  # [C, R] whether the row exists


def accumulate(old: Aggregate | None, s: Stack) -> Aggregate:
    """Return the statistics after one more chunk of an observer's runs."""
    is_good = ~s.diverged
    values = keep_columns(s.values, is_good)
    diverged, unsettled, stats = int(s.diverged.sum()), keep_columns(s.unsettled, is_good).sum(-1), moments(values)
    inside = consistency.inside(values[s.row_indices([k for (m, _), k in s.rows.items() if m == "signal_nees"])])
    innovations = _nis_moments(s, values)
    if old is None:
        return Aggregate(
            rows=s.rows,
            moments=stats,
            order=quantile_intervals.add(quantile_intervals.EMPTY, values),
            diverged=diverged,
            unsettled=unsettled,
            inside=inside,
            innovations=innovations,
        )
    return old._replace(
        moments=merge(old.moments, stats),
        order=quantile_intervals.add(old.order, values),
        diverged=old.diverged + diverged,
        unsettled=old.unsettled + unsettled,
        inside=old.inside + inside,
        innovations=merge(old.innovations, innovations) if old.innovations and innovations else None,
    )


def quantile_rows(aggregates: Mapping[str, Aggregate], chunks: Chunks) -> dict[str, Values]:
    """Return quantiles and their intervals [K, COLUMNS] by observer; with a second pass if not all values are stored."""
    at = {n: positions(n) for n in {s.moments.n for s in aggregates.values()} if n}
    positions_of = {label: at[s.moments.n] for label, s in aggregates.items() if s.moments.n}
    ranks_of = {label: ranks(p, aggregates[label].moments.n) for label, p in positions_of.items()}
    searches = {label: quantile_intervals.seek(aggregates[label].order, ranks_of[label]) for label in positions_of}
    incomplete = [label for label in positions_of if not quantile_intervals.is_complete(aggregates[label].order)]
    parts: dict[str, list[list[Values]]] = {label: [] for label in positions_of}
    for chunk in chunks() if incomplete else ():
        for label in incomplete:
            new = stack(chunk[label])
            parts[label].append(quantile_intervals.collect(searches[label], keep_columns(new.values, ~new.diverged)))
    out = {}
    for label, s in aggregates.items():
        out[label] = np.full((len(s.moments.mean), len(COLUMNS)), np.nan)
        if label in positions_of:
            values = quantile_intervals.select(s.order, searches[label], ranks_of[label], parts[label])
            out[label] = np.where(np.isnan(s.moments.mean)[:, None], np.nan, values_at(positions_of[label], values))
    return out


def summarize_observer(s: Aggregate, quantiles: Values, bounds: Values | None) -> ObserverSummary:
    """Return the rows of one observer: per signal every metric, pooled rms, divergence, unsettled and efficiency.

    quantiles are [C K, COLUMNS]; bounds [C, signals], NaN: none.
    """
    n_signals, K = len(s.unsettled) // s.cells, len(s.rows)
    means = _means(s)
    derived: dict[str, Estimate] = {}
    for metric, square in POOLED.items():
        derived[metric] = root(_of(means, _every(s, [s.rows[square, i] for i in range(n_signals)])))
    if bounds is not None:
        derived["rms_efficiency"] = rms_efficiency(bounds[:, :n_signals].ravel(), derived["steady_pooled_rmse"])
    derived["divergence_rate"] = wilson(np.full(s.cells * n_signals, s.diverged), means.n + s.diverged)
    derived["unsettled_rate"] = wilson(s.unsettled, means.n)
    derived |= _consistency_estimates(s, means)
    sizes = {metric: len(e.mean) // s.cells for metric, e in derived.items()}
    names = [
        (metric, i)
        for i in range(n_signals)
        for metric in DESCRIBED
        if ((metric, i) in s.rows if metric not in derived else i < sizes[metric])
    ]
    values = np.full((s.cells, len(names), len(ESTIMATED) + len(COLUMNS)), np.nan)
    runs = [r for r, (metric, _) in enumerate(names) if metric not in derived]
    of_runs = np.concatenate([np.stack(means[1:], 1), quantiles], 1).reshape(s.cells, K, -1)
    values[:, runs] = of_runs[:, [s.rows[names[r]] for r in runs]]
    for metric, e in derived.items():
        at = [r for r, (name, _) in enumerate(names) if name == metric]
        values[:, at, : len(ESTIMATED)] = np.stack(e[1:], 1).reshape(s.cells, sizes[metric], -1)
        if (metric, 0) in s.rows:
            values[:, at, len(ESTIMATED) :] = quantiles.reshape(s.cells, K, -1)[:, [s.rows[names[r]] for r in at]]
    exists = np.ones(values.shape[:2], bool)
    if bounds is not None:
        at = [r for r, (name, _) in enumerate(names) if name == "rms_efficiency"]
        exists[:, at] = ~np.isnan(bounds[:, :n_signals])
    n = np.array([derived[metric].n if metric in derived else means.n for metric, _ in names])
    return ObserverSummary(names, n, s.diverged, values, exists)


def _means(s: Aggregate) -> Estimate:
    """Return the means of all metrics; signed metrics have Student's interval."""
    means, student_means = positive(s.moments), student(s.moments)
    is_signed = np.tile([name in SIGNED for name, _ in s.rows], s.cells)
    low = np.where(is_signed, student_means.ci_low, means.ci_low)
    high = np.where(is_signed, student_means.ci_high, means.ci_high)
    return means._replace(ci_low=low, ci_high=high)


def _every(s: Aggregate, at: list[int]) -> NDArray[np.int64]:
    """Return the indices of rows of one grid point, at all grid points."""
    return np.add.outer(np.arange(s.cells) * len(s.rows), np.array(at, int)).ravel()


def _of(e: Estimate, at: NDArray[np.int64]) -> Estimate:
    return Estimate(e.n, *(values[at] for values in e[1:]))


def _nis_moments(s: Stack, values: Values) -> Moments | None:
    """Return the moments for the mean of `nis`; a run without a tested sample adds nothing."""
    if ("nis", 0) not in s.rows:
        return None
    nis, degrees = (values[s.row_indices([s.rows[name, 0]])] for name in ("nis", "nis_dof"))
    squares = np.where(degrees > 0, nis * degrees, 0.0)
    return moments(np.concatenate([squares, degrees, squares - degrees]))


def _over_all(sums: Moments) -> Estimate:
    """Return the sum of normalized squares divided by their degrees of freedom, with a standard error by the delta method.

    For a ratio r, the sum of squares of s - r d is a + r^2 b - r (a + b - c), with a, b and c those of s, d and s - d.
    Source: Cochran, Sampling Techniques (1977), section 2.11.
    """
    (square, degrees, _), (a, b, c) = sums.mean.reshape(3, -1), sums.m2.reshape(3, -1)
    dof = np.where(degrees > 0, degrees, np.nan)
    ratio = square / dof
    m2 = np.maximum((1 - ratio) * a + (ratio - 1) * ratio * b + ratio * c, 0.0) / dof**2
    return positive(Moments(sums.n, ratio, m2, ratio, ratio))


def _consistency_estimates(s: Aggregate, means: Estimate) -> dict[str, Estimate]:
    """Return the statistics of an observer's covariance: bands of its normalized squares, and shares within sigma."""
    if ("nees", 0) not in s.rows:
        return {}
    states = s.inside.shape[1] // s.cells
    counts = ~np.isnan(means.mean[_every(s, [s.rows["signal_nees", i] for i in range(states)])])
    shares = [wilson(count, means.n) for count in s.inside]
    blank = [Estimate(e.n, *(np.where(counts, values, np.nan) for values in e[1:])) for e in shares]
    nees_band = consistency.bands(means.n, means.mean[_every(s, [s.rows["nees_dof", 0]])])
    signal_band = consistency.bands(means.n, np.where(counts, 1.0, 0.0))
    bands = {"nees_band": nees_band, "signal_nees_band": signal_band}
    if s.innovations is not None:
        bands["nis"] = _over_all(s.innovations)
        bands["nis_band"] = consistency.bands(means.n, s.innovations.mean.reshape(3, -1)[1])
    return dict(zip(consistency.INSIDE, blank, strict=True)) | bands


def columns(e: Estimate) -> list[Row]:
    """Return estimates [K] as K rows of columns."""
    return [{"n": e.n} | dict(zip(ESTIMATED, row, strict=True)) for row in np.stack(e[1:], 1).tolist()]
