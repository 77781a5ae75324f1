"""The rows of `stats` that need no seeds: expected values without a standard error, and for the others why they are missing."""

from typing import Any

import numpy as np

from pcbench.moments import believed
from pcbench.moments.affine import refusal
from pcbench.moments.solve import CellMoments
from pcbench.statistics.consistency import INSIDE
from pcbench.statistics.description import BLANK, Row, columns
from pcbench.statistics.distributions import normal_quantile
from pcbench.statistics.estimates import Estimate, positive, reached, root, student
from pcbench.statistics.moments import Values, moments
from pcbench.statistics.order_statistics import QUANTILES

POOLED = {"pooled_rmse": "mse", "tail_pooled_rmse": "tail_mse"}
OF_LOOP = ("pooled_tracking_rmse", "tail_pooled_tracking_rmse")
OF_RUN = ("cost", "tail_cost", "pooled_input_rms", "tail_pooled_input_rms")
RUNS_ONLY = {
    "rmse": "the mean of a root is not the root of the mean: pooled_rmse is exact",
    "tail_rmse": "the mean of a root is not the root of the mean: tail_pooled_rmse is exact",
    "peak": "the largest of many ticks depends on all of them together",
    "tail_peak": "the largest of many ticks depends on all of them together",
    "settling_time": "the last of many ticks depends on all of them together",
    "recovery_time": "the last of many ticks depends on all of them together",
    "unsettled": "the last of many ticks depends on all of them together",
    "divergence": "the first of many ticks depends on all of them together",
}
ANOTHER = "it is not normal (a start in a box, or a mixture over losses or delays): known are means of squares only"
NOTHING: Row = {"n": 0} | dict.fromkeys(Estimate._fields[1:], np.nan)
ORDER = (
    *("mae", "rmse", "mse", "peak", "final", "settling_time", "recovery_time"),
    *("tail_mae", "tail_rmse", "tail_mse", "tail_peak", *OF_LOOP, *OF_RUN),
    *("nees", "nees_states", "signal_nees"),
    *(*POOLED, "divergence", "unsettled", "efficiency", *INSIDE),
)
ALWAYS = ("mae", "mse", "final", "tail_mae", "tail_mse", *POOLED)  # of every signal that has an exact answer at all
NORMAL = ("mae", "tail_mae", *INSIDE)  # of a normal error alone


def described(cell: CellMoments, bounds: dict[str, Values | None]) -> dict[str, list[Row]]:
    """Return by observer a row for every signal (its number) and metric, each with its `method` and the `reason` for a blank.

    `bounds` [signals] are what the efficiency is against, NaN where there is none.
    """
    return {label: _rows(cell, label, bounds[label]) for label in cell.signals}


def _rows(cell: CellMoments, label: str, bound: Values | None) -> list[Row]:
    why, found = refusal(cell, label), _found(cell, label, bound)
    normal = not cell.planned.layout.scattered and not cell.mixture
    out = []
    many = cell.signals[label].stop - cell.signals[label].start
    for i in range(many):
        for metric in ORDER:
            said = why or RUNS_ONLY.get(metric, "") or ("" if normal or metric not in NORMAL else ANOTHER)
            if metric == "recovery_time" and not (cell.planned.problem.jumps < cell.planned.cell.times.ticks).any():
                continue
            values = found.get(metric)
            known = values is not None and i < len(values) and not np.isnan(values[i]["mean"])
            if not (known or metric in RUNS_ONLY or (why and metric in ALWAYS)):
                continue
            row = (NOTHING if said or values is None else values[i]) | BLANK
            if metric == "final" and not said and normal and not cell.random:
                row |= _quantiles(cell, label, i)
            about = {"method": "none" if said else "exact", "reason": said or None}
            out.append({"signal": i, "metric": metric, "diverged": 0} | row | about)
    return out


def _found(cell: CellMoments, label: str, bound: Values | None) -> dict[str, list[Row]]:
    """The rows of every metric that is exact, by signal."""
    mine, s = cell.signals[label], cell.sums
    n, tail = cell.planned.cell.times.ticks, cell.planned.cell.times.tail
    out: dict[str, Estimate] = {"final": _over(cell, s.mean[mine], True)}
    for i, (prefix, count) in enumerate((("", n), ("tail_", n - tail))):
        squares = _over(cell, s.square[i, mine] / count)
        pooled = root(squares)
        out |= {prefix + "mae": _over(cell, s.absolute[i, mine] / count), prefix + "mse": squares}
        out |= {prefix + "pooled_rmse": pooled}
        if len(s.off):
            out[prefix + "pooled_tracking_rmse"] = root(_over(cell, s.off[i] / count))
            out[prefix + "pooled_input_rms"] = root(_over(cell, s.input[i][None] / count))
            if np.size(cell.planned.problem.weights.Q1 if cell.planned.problem.weights else ()):
                out[prefix + "cost"] = _over(cell, s.cost[i][None] / count)
        if bound is not None and prefix:
            out["efficiency"] = reached(bound[: len(pooled.mean)], pooled)
    if label in cell.last:
        b = cell.last[label]
        for metric, values in zip(("nees", "signal_nees", "nees_states"), believed.squares(b), strict=True):
            out[metric] = _over(cell, values if cell.shares is None else values @ cell.shares[:, None])
        out |= {metric: _over(cell, values) for metric, values in zip(INSIDE, believed.inside(b), strict=True)}
    return {metric: columns(e) for metric, e in out.items()}


def _over(cell: CellMoments, values: Any, signed: bool = False) -> Estimate:
    """Values [K, S] averaged over what is random besides the noise; without an error where nothing is."""
    if cell.random:
        return (student if signed else positive)(moments(values))
    value, nothing = values[:, 0], np.zeros(len(values))
    return Estimate(0, value, nothing, value, value)


def _quantiles(cell: CellMoments, label: str, i: int) -> dict[str, Any]:
    """Quantiles of the last error, which is normal."""
    at = cell.signals[label].start + i
    mean, std = cell.sums.mean[at, 0], cell.sums.std[at, 0]
    each = {q: float(mean + std * normal_quantile(int(q[1:]) / 100)) for q in QUANTILES}
    return each | {q + end: value for q, value in each.items() for end in ("_low", "_high")}
