"""The metrics of runs, and all metrics of one observer as the rows of one array. NumPy, no jax."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.confidence_intervals import Values

INTERVALS = ("interval_width", "interval_coverage")  # of an observer with bounds
RUN_METRICS = (
    *("mae", "rmse", "mse", "max_abs_error", "final_error", "settling_time", "recovery_time"),
    *("steady_mae", "steady_rmse", "steady_mse", "steady_max_abs_error"),
    *("tracking_rmse", "steady_tracking_rmse"),
    *("lq_cost", "steady_lq_cost", "input_rms", "steady_input_rms"),
    *("nees", "nees_dof", "nis", "nis_dof", "signal_nees", *INTERVALS, "sent_fraction"),
)  # recovery_time if an unknown input jumps; tracking_* for the states that follow a path
# one number per run, stored with the first signal: of a closed loop, of sensors, or of an observer with a covariance
OF_RUN = (
    *("lq_cost", "steady_lq_cost", "input_rms", "steady_input_rms"),
    *("nees", "nees_dof", "nis", "nis_dof", "sent_fraction"),
)
OPTIONAL = (*OF_RUN, "signal_nees", *INTERVALS)  # in a table of runs only if they exist
SIGNED = ("final_error",)  # signed error; all others cannot be negative
# neither large nor small is better: a narrow interval is only good if it contains the state
UNRANKED = (*SIGNED, "nees", "nees_dof", "nis", "nis_dof", "signal_nees", *INTERVALS, "sent_fraction")
COMPARED = tuple(m for m in RUN_METRICS if m not in UNRANKED)
POOLED = {"pooled_rmse": "mse", "steady_pooled_rmse": "steady_mse"}

CHUNK = 4096  # seeds per chunk: the last bits depend on where chunks end, so they end where seeds % CHUNK = 0

Results = dict[str, NDArray[Any]]  # of one observer: metric -> [signals, n], `diverged` [n], `unsettled` [signals, n]
Chunks = Callable[[], Iterable[dict[str, Results]]]  # a pass over a grid point's runs: by observer, seeds in order
Scalar = TypeVar("Scalar", bound=np.generic)
SignalMetric = tuple[str, int]  # a metric of a signal (by its index)


class Stack(NamedTuple):
    """One observer's metrics over n runs at C grid points. tracking_* has rows only for the first signals, with a set point."""

    rows: dict[SignalMetric, int]
    values: Values  # [C K, n]
    diverged: NDArray[np.bool_]  # [n]; none if there are several grid points
    unsettled: NDArray[np.bool_]  # [C signals, n]

    def row_indices(self, rows: list[int]) -> NDArray[np.int64]:
        """Return the indices of rows of one grid point, at all grid points."""
        K = len(self.rows)
        return np.add.outer(np.arange(0, len(self.values), K), np.array(rows, int)).ravel()


def stack(results: Results) -> Stack:
    """Return all metrics of an observer as rows."""
    present = [m for m in RUN_METRICS if m in results]
    names = [(m, i) for m in present for i in range(len(results[m]))]
    values = np.concatenate([results[m] for m in present], dtype=np.float64)
    return Stack({name: k for k, name in enumerate(names)}, values, results["diverged"], results["unsettled"])


def join_stacks(stacks: list[Stack]) -> Stack:
    """Return the stacks of an observer at grid points with equal rows and runs, without divergence, as one."""
    first = stacks[0]
    if len(stacks) == 1:
        return first
    return first._replace(
        values=np.concatenate([s.values for s in stacks]), unsettled=np.concatenate([s.unsettled for s in stacks])
    )


def keep_columns(values: NDArray[Scalar], keep: NDArray[np.bool_]) -> NDArray[Scalar]:
    """Return the columns of values [K, n] where keep [n]."""
    return values if keep.all() else np.take(values, np.flatnonzero(keep), axis=-1)  # C order, unlike values[:, keep]
