"""Numbers over runs: estimates with their uncertainty, and paired comparisons. NumPy and SciPy, no jax.

Intervals are 95 % Student intervals over seeds. `pooled_rmse` is the square root of the mean square over runs: its interval
is that of the mean square, its standard error by the delta method; `efficiency` likewise. Diverged runs are counted, never
averaged; their fraction, and that of the others not settled when the tail starts, have Wilson's interval. p-values are of the
paired t-test on common draws, with Holm's correction over all comparisons of one scenario, signal and metric in the study.
Where the runs do not vary (no noise) the interval has no width and there is no test: p is NaN.
"""

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from pcbench.errors import unknown

RUN_METRICS = (
    *("mae", "rmse", "mse", "peak", "final", "settling_time", "recovery_time"),
    *("tail_mae", "tail_rmse", "tail_mse", "tail_peak"),
    *("tracking_rmse", "tail_tracking_rmse"),
)  # recovery_time where an unknown input jumps, tracking_* of what a controller is to lead along a path
COMPARED = tuple(m for m in RUN_METRICS if m != "final")  # a signed error is neither better nor worse
POOLED = {"pooled_rmse": "mse", "tail_pooled_rmse": "tail_mse"}
QUANTILES = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
SAME = 1e-9  # two metrics of a run that differ by less than this part are a tie: rounding, not merit
ZERO = 1e-11  # errors below this part of the prior are zero up to rounding
SEEN = 1e-9  # a bound below this part of the prior is zero for every purpose: no efficiency against it

Z95 = 1.959963984540054  # quantile of the normal distribution
Values = NDArray[np.float64]
Row = dict[str, Any]


def mean(values: Values) -> Row:
    """Return n, mean, standard error and 95 % interval of values [n]; NaN where there are too few."""
    n = len(values)
    out = {"n": n, "mean": np.nan, "se": np.nan, "ci_low": np.nan, "ci_high": np.nan}
    if n and (values == values[0]).all():  # exactly, without the rounding of a sum
        centre, se = float(values[0]), 0.0 if n > 1 else np.nan
    elif n:
        centre, se = float(values.mean()), float(values.std(ddof=1) / np.sqrt(n))
    else:
        return out
    half = se * float(stdtrit(n - 1, 0.975)) if n > 1 else np.nan
    return out | {"mean": centre, "se": se, "ci_low": centre - half, "ci_high": centre + half}


def quantiles(values: Values) -> Row:
    """Return the quantiles over runs of values [n]; NaN where there are none."""
    found = np.quantile(values, list(QUANTILES.values())) if len(values) else [np.nan] * len(QUANTILES)
    return dict(zip(QUANTILES, map(float, found), strict=True))


def pooled(squares: Values) -> Row:
    """Return the root of the mean of squares [n] with its uncertainty."""
    m = mean(squares)
    root = np.sqrt(m["mean"])
    se = m["se"] / (2 * root) if root > 0 else m["se"]
    low, high = np.sqrt(max(m["ci_low"], 0.0)) if m["n"] > 1 else np.nan, np.sqrt(m["ci_high"])
    return m | {"mean": float(root), "se": float(se), "ci_low": float(low), "ci_high": float(high)}


def efficiency(tail_squares: Values, bound: float) -> Row:
    """Return bound / tail_pooled_rmse: 1 attains the bound, 1/5 is five times its rms. Square it for the variance ratio."""
    p = pooled(tail_squares)
    value = bound / p["mean"] if p["mean"] > 0 else np.nan
    return p | {
        "mean": value,
        "se": value * p["se"] / p["mean"] if p["mean"] > 0 else np.nan,
        "ci_low": bound / p["ci_high"] if p["ci_high"] > 0 else np.nan,
        "ci_high": bound / p["ci_low"] if p["ci_low"] > 0 else np.nan,
    }


def fraction(happened: NDArray[np.bool_]) -> Row:
    """Return the fraction of runs [n] in which something happened, with Wilson's 95 % interval.

    Source: Wilson, J. Am. Stat. Assoc. 22 (1927), 209-212.
    """
    n, blank = len(happened), {"mean": np.nan, "se": np.nan, "ci_low": np.nan, "ci_high": np.nan}
    if not n:
        return {"n": 0} | blank
    p, z2 = float(happened.mean()), Z95**2
    centre, half = p + z2 / (2 * n), Z95 * float(np.sqrt(p * (1 - p) / n + z2 / (4 * n * n)))
    low, high = ((centre - half) / (1 + z2 / n) if p else 0.0, (centre + half) / (1 + z2 / n) if p < 1 else 1.0)
    return {"n": n, "mean": p, "se": float(np.sqrt(p * (1 - p) / n)), "ci_low": low, "ci_high": high}


def describe(results: dict[str, NDArray[Any]], signal: int, bound: float | None) -> Iterable[Row]:
    """Yield a row for every metric of one signal that there is; results are metric -> [n, seeds], `diverged` [seeds].

    Of tracking_* only the first signals have a row: those with a set point.
    """
    good = ~results["diverged"]
    blank = dict.fromkeys(QUANTILES, np.nan)
    common = {"diverged": int((~good).sum())}
    for metric in (m for m in RUN_METRICS if m in results and signal < len(results[m])):
        values = results[metric][signal][good]
        yield {"metric": metric} | common | mean(values) | quantiles(values)
    for metric, square in POOLED.items():
        yield {"metric": metric} | common | pooled(results[square][signal][good]) | blank
    yield {"metric": "divergence"} | common | fraction(~good) | blank
    yield {"metric": "unsettled"} | common | fraction(results["unsettled"][signal][good]) | blank
    if bound is not None:
        yield {"metric": "efficiency"} | common | efficiency(results["tail_mse"][signal][good], bound) | blank


def compare(a: Values, b: Values, bad_a: NDArray[np.bool_], bad_b: NDArray[np.bool_], floor: float = 0.0) -> Row:
    """Compare a metric (smaller is better) of two observers on the same draws [seeds].

    The difference a - b is over runs in which neither diverged. `prob_a_better` is over all runs: a diverged run loses
    against one that did not, and a tie counts half. Values that differ by no more than `floor` are a tie: rounding of zero.
    """
    both = ~bad_a & ~bad_b
    d = mean(a[both] - b[both])
    tie = np.abs(a - b) <= SAME * np.maximum(np.abs(a), np.abs(b)) + floor
    wins = np.where(both, np.where(tie, 0.5, a < b), 0.5 + 0.5 * (bad_b & ~bad_a) - 0.5 * (bad_a & ~bad_b))
    varies = d["n"] > 1 and d["se"] > 0 and not tie[both].all()
    p = 2 * float(stdtr(d["n"] - 1, -abs(d["mean"] / d["se"]))) if varies else np.nan
    return {
        "n": d["n"],
        "mean_diff": d["mean"],
        "se": d["se"],
        "ci_low": d["ci_low"],
        "ci_high": d["ci_high"],
        "prob_a_better": float(wins.mean()) if both.any() or (bad_a != bad_b).any() else np.nan,
        "p_value": p,
    }


def holm(p_values: Values) -> Values:
    """Return Holm's step-down adjustment of p-values [k]; NaN stays NaN and is not counted."""
    out = np.full(len(p_values), np.nan)
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    steps = p_values[order] * (len(order) - np.arange(len(order)))
    out[order] = np.minimum(np.maximum.accumulate(steps), 1.0) if len(order) else steps
    return out


def pairs(results: dict[str, dict[str, NDArray[Any]]], signals: list[str], sizes: tuple[float, ...]) -> Iterable[Row]:
    """Yield a row for every pair of observers, signal and metric of one cell; `sizes` are the signals' typical sizes.

    Only of signals that both estimate.
    """
    for a, b in itertools.combinations(results, 2):
        ra, rb = results[a], results[b]
        both = min(len(ra["mae"]), len(rb["mae"]))
        for i, signal in enumerate(signals[:both]):
            for metric in (m for m in COMPARED if m in ra and i < len(ra[m])):
                floor = ZERO * sizes[i] ** (2 if metric in POOLED.values() else 1)
                row = compare(ra[metric][i], rb[metric][i], ra["diverged"], rb["diverged"], floor)
                yield {"observer_a": a, "observer_b": b, "signal": signal, "metric": metric} | row


def adjusted(rows: list[Row]) -> list[Row]:
    """Put Holm's adjusted p-value into the rows of `pairs`, one family a scenario, signal and metric."""
    families: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        families.setdefault((row["scenario"], row["signal"], row["metric"]), []).append(row)
    for family in families.values():
        for row, p in zip(family, holm(np.array([r["p_value"] for r in family])), strict=True):
            row["p_holm"] = float(p)
    return rows


def compared(metric: str, where: str) -> str:
    """Return the name of a metric that runs are compared by; raise UserError with the nearest where there is none."""
    if metric not in COMPARED:
        raise unknown(where, "metric of a run", metric, COMPARED)
    return metric
