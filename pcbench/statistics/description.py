"""What is known of each observer's runs in one cell, in chunks: rows of the table `stats`. NumPy and SciPy, no jax."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics import consistency, selection
from pcbench.statistics.estimates import Estimate, positive, reached, root, student, wilson
from pcbench.statistics.moments import Moments, Values, merge, moments
from pcbench.statistics.order_statistics import COLUMNS, positions, ranks, read
from pcbench.statistics.stack import POOLED, RUN_METRICS, SIGNED, Chunks, SignalMetric, Stack, kept, stack

Row = dict[str, Any]
DESCRIBED = (
    *RUN_METRICS,
    *POOLED,
    "divergence",
    "unsettled",
    "efficiency",
    *consistency.BANDS.values(),
    *consistency.INSIDE,
)
BLANK = dict.fromkeys(COLUMNS, float("nan"))


class Aggregate(NamedTuple):
    """What is kept of one observer's runs; of those that diverged only how many there are."""

    rows: dict[SignalMetric, int]
    moments: Moments  # [K]
    order: selection.Order  # [K]
    diverged: int
    unsettled: NDArray[np.int64]  # [signals]
    inside: NDArray[np.int64]  # [3, states] within one, two, three sigma, of an observer that says how wrong it is


def see(before: Aggregate | None, s: Stack) -> Aggregate:
    """Return what is kept after one more chunk of an observer's runs."""
    good = ~s.diverged
    values = kept(s.values, good)
    diverged, unsettled, found = int(s.diverged.sum()), kept(s.unsettled, good).sum(-1), moments(values)
    inside = consistency.inside(values[[k for (m, _), k in s.rows.items() if m == "signal_nees"]])
    if before is None:
        return Aggregate(s.rows, found, selection.add(selection.EMPTY, values), diverged, unsettled, inside)
    return Aggregate(
        s.rows,
        merge(before.moments, found),
        selection.add(before.order, values),
        before.diverged + diverged,
        before.unsettled + unsettled,
        before.inside + inside,
    )


def spread(seen: Mapping[str, Aggregate], chunks: Chunks) -> dict[str, Values]:
    """Return the quantiles and their intervals [K, COLUMNS] by observer; one more pass where not all values are held."""
    at = {n: positions(n) for n in {s.moments.n for s in seen.values()} if n}
    where = {label: at[s.moments.n] for label, s in seen.items() if s.moments.n}
    asked = {label: ranks(each, seen[label].moments.n) for label, each in where.items()}
    sought = {label: selection.seek(seen[label].order, asked[label]) for label in where}
    open_ = [label for label in where if not selection.settled(seen[label].order)]
    parts: dict[str, list[list[Values]]] = {label: [] for label in where}
    for chunk in chunks() if open_ else ():
        for label in open_:
            new = stack(chunk[label])
            parts[label].append(selection.collect(sought[label], kept(new.values, ~new.diverged)))
    out = {}
    for label, s in seen.items():
        out[label] = np.full((len(s.rows), len(COLUMNS)), np.nan)
        if label in where:
            found = read(where[label], selection.select(s.order, sought[label], asked[label], parts[label]))
            out[label] = np.where(np.isnan(s.moments.mean)[:, None], np.nan, found)
    return out


def described(s: Aggregate, quantiles: Values, bound: Values | None) -> list[Row]:
    """Return the rows of one observer: by signal every metric, pooled rms, divergence, unsettled and efficiency.

    quantiles are [K, COLUMNS]; bound [signals], NaN where there is none.
    """
    many, means, plain = len(s.unsettled), positive(s.moments), student(s.moments)
    signed = np.array([name in SIGNED for name, _ in s.rows])
    low, high = (np.where(signed, *(getattr(e, end) for e in (plain, means))) for end in ("ci_low", "ci_high"))
    means = means._replace(ci_low=low, ci_high=high)
    known = [
        row | dict(zip(COLUMNS, q, strict=True)) for row, q in zip(columns(means), quantiles.tolist(), strict=True)
    ]
    rows = {name: known[k] for name, k in s.rows.items()}

    def put(metric: str, e: Estimate) -> None:
        rows.update({(metric, i): row | BLANK for i, row in enumerate(columns(e))})

    for metric, square in POOLED.items():
        at = [s.rows[square, i] for i in range(many)]
        pooled = root(Estimate(means.n, *(values[at] for values in means[1:])))
        put(metric, pooled)
        if bound is not None and metric == "tail_pooled_rmse":
            put("efficiency", reached(bound[:many], pooled))
    put("divergence", wilson(np.full(many, s.diverged), means.n + s.diverged))
    put("unsettled", wilson(s.unsettled, means.n))
    for metric, e in _known(s, means).items():
        put(metric, e)
    for i in range(many):
        if bound is not None and np.isnan(bound[i]):
            del rows["efficiency", i]
    return [
        {"signal": i, "metric": metric, "n": row["n"], "diverged": s.diverged} | row
        for i in range(many)
        for metric in DESCRIBED
        if (row := rows.get((metric, i)))
    ]


def _known(s: Aggregate, means: Estimate) -> dict[str, Estimate]:
    """What is known of an observer's own covariance: the bands of its normalised squares, and its sigma shares."""
    if ("nees", 0) not in s.rows:
        return {}
    states = s.inside.shape[1]
    counts = ~np.isnan(means.mean[[s.rows["signal_nees", i] for i in range(states)]])
    shares = [wilson(count, means.n) for count in s.inside]
    blank = [Estimate(e.n, *(np.where(counts, values, np.nan) for values in e[1:])) for e in shares]
    whole = consistency.bands(means.n, means.mean[[s.rows["nees_states", 0]]])
    each = consistency.bands(means.n, np.where(counts, 1.0, 0.0))
    bands = {"nees_band": whole, "signal_nees_band": each}
    if (at := s.rows.get(("nis_degrees", 0))) is not None:
        bands["nis_band"] = consistency.bands(means.n, means.mean[[at]])
    return dict(zip(consistency.INSIDE, blank, strict=True)) | bands


def columns(e: Estimate) -> list[Row]:
    """Return estimates [K] as K parts of rows."""
    names = Estimate._fields[1:]
    return [{"n": e.n} | dict(zip(names, row, strict=True)) for row in np.stack(e[1:], 1).tolist()]
