"""The rows of `stats` that need no seeds: expected values without a standard error, and a reason for each missing value.

The rows of one observer at one grid point are returned as columns.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcbench.moments import nees
from pcbench.moments.solve import CellMoments
from pcbench.statistics.confidence_intervals import Estimate, Values, moments, positive, rms_efficiency, root, student
from pcbench.statistics.consistency import INSIDE
from pcbench.statistics.distributions import normal_quantile
from pcbench.statistics.quantile_intervals import COLUMNS, QUANTILES

POOLED = {"pooled_rmse": "mse", "steady_pooled_rmse": "steady_mse"}
OF_LOOP = ("pooled_tracking_rmse", "steady_pooled_tracking_rmse")
OF_RUN = ("lq_cost", "steady_lq_cost", "pooled_input_rms", "steady_pooled_input_rms")
RUNS_ONLY = {
    "rmse": "the mean of a root is not the root of the mean: pooled_rmse is exact",
    "steady_rmse": "the mean of a root is not the root of the mean: steady_pooled_rmse is exact",
    "max_abs_error": "the largest of many ticks depends on all of them together",
    "steady_max_abs_error": "the largest of many ticks depends on all of them together",
    "settling_time": "the last of many ticks depends on all of them together",
    "recovery_time": "the last of many ticks depends on all of them together",
    "unsettled_rate": "the last of many ticks depends on all of them together",
    "divergence_rate": "the first of many ticks depends on all of them together",
}
NOT_NORMAL = "it is not normal (a start in a box, or a mixture over losses or delays): known are means of squares only"
NUMBERS = Estimate._fields[1:]
ORDER = (
    *("mae", "rmse", "mse", "max_abs_error", "final_error", "settling_time", "recovery_time"),
    *("steady_mae", "steady_rmse", "steady_mse", "steady_max_abs_error", *OF_LOOP, *OF_RUN),
    *("nees", "nees_dof", "signal_nees"),
    *(*POOLED, "divergence_rate", "unsettled_rate", "rms_efficiency", *INSIDE),
)
ALWAYS = ("mae", "mse", "final_error", "steady_mae", "steady_mse", *POOLED)  # of every signal with an exact answer
NORMAL_ONLY = ("mae", "steady_mae", *INSIDE)  # of a normal error only


Columns = dict[str, Any]  # by name: an array with one value per row


def stats_columns(cell: CellMoments, label: str, why: str, bound: Values | None) -> Columns:
    """Return the rows of an observer as columns, each with its `method` and the `reason` for a missing value.

    - `signal` and `metric` are indices; `metric` is an index of ORDER.
    - `why`: the reason that this observer has no exact answer at this grid point; empty if it has.
    - `bound` [signals]: the Kalman bound for the efficiency, NaN if there is none.
    """
    signals, estimates = cell.signals[label], _estimates(cell, label, bound)
    n_signals = signals.stop - signals.start
    normal = not cell.plan.layout.scattered and not cell.mixture
    values, n = np.full((len(NUMBERS), n_signals, len(ORDER)), np.nan), np.zeros(len(ORDER), int)
    for j, name in enumerate(ORDER):
        if (e := estimates.get(name)) is not None:
            values[:, : len(e.mean), j], n[j] = [field[:n_signals] for field in e[1:]], e.n
    reasons, methods, has_row = _reasons(why, normal)
    is_missing = methods == "none"
    mask = has_row | ~np.isnan(values[0])
    if not (cell.plan.problem.jumps < cell.plan.cell.times.ticks).any():
        mask[:, ORDER.index("recovery_time")] = False
    signal, metric = np.nonzero(mask)
    spread = np.full((len(COLUMNS), len(signal)), np.nan)
    if normal and not why and not cell.random:
        final = metric == ORDER.index("final_error")
        spread[:, final] = _quantiles(cell, label)[:, signal[final]]
    numbers = np.where(is_missing[metric], np.nan, values[:, signal, metric])
    return {
        "signal": signal,
        "metric": metric,
        "diverged": np.zeros(len(signal), int),
        "n": np.where(is_missing, 0, n)[metric],
        **dict(zip((*NUMBERS, *COLUMNS), (*numbers, *spread), strict=True)),
        "method": methods[metric],
        "reason": reasons[metric],
    }


@lru_cache(256)
def _reasons(why: str, normal: bool) -> tuple[NDArray[np.object_], NDArray[np.object_], NDArray[np.bool_]]:
    """Return for each metric of ORDER the reason for a missing value or None, its `method`, and whether it always has a row."""
    not_normal = {} if normal else dict.fromkeys(NORMAL_ONLY, NOT_NORMAL)
    texts = [why or RUNS_ONLY.get(metric, "") or not_normal.get(metric, "") for metric in ORDER]
    has_row = [metric in RUNS_ONLY or bool(why and metric in ALWAYS) for metric in ORDER]
    methods = np.array(["none" if reason else "exact" for reason in texts], object)
    return np.array([reason or None for reason in texts], object), methods, np.array(has_row)


def _estimates(cell: CellMoments, label: str, bound: Values | None) -> dict[str, Estimate]:
    """Return every exact metric of the signals."""
    signals, s = cell.signals[label], cell.sums
    n, tail = cell.plan.cell.times.ticks, cell.plan.cell.times.tail
    out: dict[str, Estimate] = {"final_error": _average(cell, s.mean[signals], True)}
    for i, (prefix, count) in enumerate((("", n), ("steady_", n - tail))):
        squares = _average(cell, s.square[i, signals] / count)
        pooled_rmse = root(squares)
        out |= {prefix + "mae": _average(cell, s.absolute[i, signals] / count), prefix + "mse": squares}
        out |= {prefix + "pooled_rmse": pooled_rmse}
        if cell.plan.layout.controller:
            out[prefix + "pooled_tracking_rmse"] = root(_average(cell, s.tracking[i] / count))
            out[prefix + "pooled_input_rms"] = root(_average(cell, s.input[i][None] / count))
            if np.size(cell.plan.problem.weights.Q1 if cell.plan.problem.weights else ()):
                out[prefix + "lq_cost"] = _average(cell, s.cost[i][None] / count)
        if bound is not None and prefix:
            out["rms_efficiency"] = rms_efficiency(bound[: len(pooled_rmse.mean)], pooled_rmse)
    if label in cell.final_errors:
        final_errors = cell.final_errors[label]
        for metric, values in zip(("nees", "signal_nees", "nees_dof"), nees.squares(final_errors), strict=True):
            weights = cell.mode_probabilities
            out[metric] = _average(cell, values if weights is None else values @ weights[:, None])
        shares = nees.inside(final_errors)
        out |= {metric: _average(cell, values) for metric, values in zip(INSIDE, shares, strict=True)}
    return out


def _average(cell: CellMoments, values: ArrayLike, is_signed: bool = False) -> Estimate:
    """Return values [K, S] averaged over realisations; without an error if there is only one."""
    values = np.asarray(values)
    if cell.random:
        return (student if is_signed else positive)(moments(values))
    value, zeros = values[:, 0], np.zeros(len(values))
    return Estimate(0, value, zeros, value, value)


def _quantiles(cell: CellMoments, label: str) -> Values:
    """Return quantiles [of COLUMNS, signals] of the last errors, which are normal: each is its own interval."""
    signals = cell.signals[label]
    mean, std = cell.sums.mean[signals, 0], cell.sums.std[signals, 0]
    quantiles = {q: mean + std * normal_quantile(int(q[1:]) / 100) for q in QUANTILES}
    return np.stack([quantiles[name.split("_")[0]] for name in COLUMNS])
