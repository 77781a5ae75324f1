"""The metrics of runs, and all those of one observer as the rows of one array. NumPy, no jax."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.confidence_intervals import Values

INTERVALS = ("interval_width", "interval_coverage")  # of an observer that has bounds
RUN_METRICS = (
    *("mae", "rmse", "mse", "max_abs_error", "final_error", "settling_time", "recovery_time"),
    *("steady_mae", "steady_rmse", "steady_mse", "steady_max_abs_error"),
    *("tracking_rmse", "steady_tracking_rmse"),
    *("lq_cost", "steady_lq_cost", "input_rms", "steady_input_rms"),
    *("nees", "nees_dof", "nis", "nis_dof", "signal_nees", *INTERVALS, "sent_fraction"),
)  # recovery_time where an unknown input jumps, tracking_* of what a controller is to lead along a path
OF_RUN = (
    "lq_cost",
    "steady_lq_cost",
    "input_rms",
    "steady_input_rms",
    "nees",
    "nees_dof",
    "nis",
    "nis_dof",
    "sent_fraction",
)  # of a closed loop, of sensors, or of an observer that says how wrong it is: one number a run, with its first signal
ASKED = (*OF_RUN, "signal_nees", *INTERVALS)  # that a table of runs has only where there are such
SIGNED = ("final_error",)  # an error with its sign: all others cannot be negative
UNRANKED = (
    *SIGNED,
    "nees",
    "nees_dof",
    "nis",
    "nis_dof",
    "signal_nees",
    *INTERVALS,
    "sent_fraction",
)  # neither a large nor a small one is better: a narrow interval is only where it contains the state
COMPARED = tuple(m for m in RUN_METRICS if m not in UNRANKED)
POOLED = {"pooled_rmse": "mse", "steady_pooled_rmse": "steady_mse"}

CHUNK = 4096  # seeds in a chunk: numbers depend on where chunks end (in the last bit), so it is where seeds % CHUNK = 0

Results = dict[str, NDArray[Any]]  # of one observer: metric -> [signals, n], `diverged` [n], `unsettled` [signals, n]
Chunks = Callable[
    [], Iterable[dict[str, Results]]
]  # a pass over a cell's runs: by observer, the same seeds for all, in order
Scalar = TypeVar("Scalar", bound=np.generic)
SignalMetric = tuple[str, int]  # a metric of a signal (by its number)


class Stack(NamedTuple):
    """One observer's metrics over n runs in C cells. Of tracking_* only first signals have a row: those with a set point."""

    rows: dict[SignalMetric, int]
    values: Values  # [C K, n]
    diverged: NDArray[np.bool_]  # [n]; in none where there are several cells
    unsettled: NDArray[np.bool_]  # [C signals, n]

    def every(self, rows: list[int]) -> NDArray[np.int64]:
        """Return some rows of one cell in all of them."""
        K = len(self.rows)
        return np.add.outer(np.arange(0, len(self.values), K), np.array(rows, int)).ravel()


def stack(results: Results) -> Stack:
    """Return all metrics of an observer as rows."""
    present = [m for m in RUN_METRICS if m in results]
    names = [(m, i) for m in present for i in range(len(results[m]))]
    values = np.concatenate([results[m] for m in present], dtype=np.float64)
    return Stack({name: k for k, name in enumerate(names)}, values, results["diverged"], results["unsettled"])


def join_stacks(stacks: list[Stack]) -> Stack:
    """Return the stacks of an observer in cells with the same rows and so many runs, none of which diverged, as one."""
    first = stacks[0]
    if len(stacks) == 1:
        return first
    return first._replace(
        values=np.concatenate([s.values for s in stacks]), unsettled=np.concatenate([s.unsettled for s in stacks])
    )


def keep_columns(values: NDArray[Scalar], keep: NDArray[np.bool_]) -> NDArray[Scalar]:
    """Return the columns of values [K, n] to keep [n]."""
    return values if keep.all() else np.take(values, np.flatnonzero(keep), axis=-1)  # C order, unlike values[:, keep]
