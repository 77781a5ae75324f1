"""The columns of the tables for other programs, with unit and meaning; a change needs a new SCHEMA number. No jax."""

import itertools
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from pcbench.fields import FIELDS, names
from pcbench.statistics import OPTIONAL, QUANTILES, RUN_METRICS

if TYPE_CHECKING:
    from pcbench.study.grid import Cell

SCHEMA = "1"  # of every file; one more for each change once there is a release
AXIS_UNITS = {f.name: f.unit for f in FIELDS}
Columns = Mapping[str, ArrayLike | pa.Array]  # by name
CONSISTENCY = (
    "Fraction of runs whose error at tick N-1 is within one, two or three of the observer's standard deviations, with Wilson's "
    "interval: coverage_1_sigma, coverage_2_sigma, coverage_3_sigma. The 95 % band of mean nees, nis or signal_nees for a true "
    "covariance (chi-square), in the columns of the interval: nees_band, nis_band, signal_nees_band"
)
MEANING = {
    "study": "name of the study",
    "scenario": "name of the scenario",
    "plant": "plant of the scenario",
    "observer": "observer, with the options in study.toml",
    "observer_a": "first observer of the pair",
    "observer_b": "second observer of the pair",
    "cell": "number of the grid point within its scenario, from 0",
    "seed": "seed of the run: with the study's root seed it determines every random number of the run",
    "signal": "state, unknown input or parameter whose error e = x - xhat is measured",
    "predicts_unknown_input": "whether the observer's prediction to the present includes its estimate of the unknown input; "
    "null: the observer has no such estimate, or no prediction",
    **{f"predicts_unknown_input_{side}": f"predicts_unknown_input of observer_{side}" for side in "ab"},
    "certified": "whether the observer's gains have a certificate at this grid point (an inequality, checked again, with a "
    "margin above 0); null: the observer has no gains",
    **{f"certified_{side}": f"certified of observer_{side}" for side in "ab"},
    "unit": "unit of the signal; in a row with a metric, the unit of the metric",
    "mae": "mean |e| over ticks 0 .. N-1",
    "rmse": "square root of the mean of e^2 over ticks 0 .. N-1",
    "mse": "mean of e^2 over ticks 0 .. N-1 [unit squared]",
    "max_abs_error": "largest |e| over ticks 0 .. N-1",
    "final_error": "e at tick N-1, signed",
    "settling_time": "time [s] of the last exit of |e| from the scenario's band; the duration if |e| ends outside",
    "recovery_time": "time [s] from a jump of the unknown input to the last exit of |e| from its band before the next jump or "
    "the end. The longest of all jumps from the scenario's steady_start on; null: there is no such jump",
    "steady_mae": "mean |e| from the scenario's steady_start on",
    "steady_rmse": "square root of the mean of e^2 from steady_start on",
    "steady_mse": "mean of e^2 from steady_start on [unit squared]",
    "steady_max_abs_error": "largest |e| from steady_start on",
    "tracking_rmse": "root mean square of the set point minus the state, in a closed loop; null: the signal has no set point",
    "steady_tracking_rmse": "the same as tracking_rmse, from steady_start on",
    "status": "diverged; or unsettled: the error of this signal left its band after steady_start; or settled",
    "diverged": "in runs: the error became non-finite or exceeded the scenario's divergence threshold (its metrics are null). "
    "In stats: the number of such runs, which are left out of all means",
    "divergence_time": "time [s] at which the error of a diverged run exceeded the divergence threshold; null for other runs",
    "metric": "a metric of `runs`, or one of these. Root of the mean square over runs: pooled_rmse, steady_pooled_rmse. "
    "The Kalman bound divided by steady_pooled_rmse: rms_efficiency. The bound is the least such error of any causal "
    "estimator, on average over x(0) ~ N(xhat0, P0). Fraction of runs that diverged, with Wilson's interval: divergence_rate. "
    "Fraction of the other runs whose error left its band after steady_start, with Wilson's interval: unsettled_rate. "
    + CONSISTENCY,
    "method": "runs: an estimate from simulated runs; exact: the expected value over all noise, with an se of 0. If the "
    "schedule is random, it is a mean over schedules, and se belongs to this mean. none: no number, see `reason`",
    "reason": "why there is no exact number; null: no number is missing",
    "t": "time [s]",
    "std": "standard deviation of the error e at t, over all noise; `mean` is its mean",
    "n": "number of runs in the estimate; for an exact number 0, or the number of schedules in its mean",
    "mean": "estimate over runs, or exact",
    "se": "its standard error",
    "ci_low": "lower end of its 95 % interval over seeds",
    "ci_high": "upper end of its 95 % interval over seeds",
    "mean_diff": "mean of metric(a) - metric(b) over the common runs in which neither diverged; negative: a is better",
    "prob_a_better": "fraction of runs in which a is better; a tie (equal to 1e-7) counts half, a diverged run loses",
    "p_value": "two-sided paired t-test of mean_diff = 0; null: the runs do not vary",
    "p_holm": "p_value with Holm's correction over the study's comparisons of this scenario, signal and metric",
    "lq_cost": "mean of (x - x_ref)'Q1 (x - x_ref) + (u - u_ref)'Q2 (u - u_ref) over ticks 0 .. N-1, "
    "in a closed loop with weights; one number per run, in the row of its first signal",
    "steady_lq_cost": "the same as lq_cost, from steady_start on",
    "input_rms": "square root of the mean of u'u over ticks 0 .. N-1, in a closed loop; one number per run, in the row of its "
    "first signal",
    "steady_input_rms": "the same as input_rms, from steady_start on",
    "nees": "normalised estimation error squared: e' P^-1 e / n at tick N-1. P is the observer's covariance of its error of "
    "the plant's n states, without states that are known exactly. The mean is 1 if P is true. One number per run, in the row "
    "of its first signal",
    "nees_dof": "number of states n in nees",
    "nis": "normalised innovation squared: the sum of nu' S^-1 nu over all measurements that the observer tests, divided by "
    "nis_dof. The innovation nu is a measurement minus its prediction from all earlier arrivals, and S is the observer's "
    "covariance of nu. One number per run, in the row of its first signal; null: no measurement was tested. In stats: the sum "
    "over all runs, divided by the sum of nis_dof",
    "nis_dof": "number of values in nis",
    "interval_width": "mean of high - low over ticks 0 .. N-1. The interval low .. high of the signal is the observer's, and "
    "contains the signal if noise and initial error are within its bounds",
    "interval_coverage": "fraction of ticks 0 .. N-1 at which low <= signal <= high; 1 if noise and initial error are within "
    "the bounds of the observer",
    "sent_fraction": "number of samples sent divided by the number of samples taken, of all outputs together. One number per "
    "run, in the row of its first signal",
    "signal_nees": "square of e, divided by the observer's variance of e, at tick N-1; null: this state is known exactly",
}
MEANING |= {f.name: f.meaning for f in FIELDS}
MEANING |= {q: f"{int(q[1:])} % quantile over runs" for q in QUANTILES}
for side, end in (("low", "lower"), ("high", "upper")):
    MEANING |= {f"{q}_{side}": f"{end} end of the 95 % interval of {q}; null: open" for q in QUANTILES}
INTERVALS = (
    "95 %, over seeds. Means and root mean squares of what cannot be negative: Student's of the logarithm, that is "
    "mean exp(-+ t se / mean); final and mean_diff, which have a sign: Student's; fractions: Wilson's; quantiles: Nyblom's of "
    "order statistics"
)
UNITLESS = (
    "rms_efficiency divergence_rate unsettled_rate lq_cost steady_lq_cost nees nees_dof signal_nees nis nis_dof nees_band "
    "nis_band signal_nees_band coverage_1_sigma coverage_2_sigma coverage_3_sigma interval_coverage "
    "sent_fraction"
)
OF_INPUT = "input_rms steady_input_rms pooled_input_rms steady_pooled_input_rms"
OWN_UNITS = dict.fromkeys(UNITLESS.split(), "1")  # not the signal's
OWN_UNITS |= dict.fromkeys(OF_INPUT.split(), "unit of the input")
OWN_UNITS |= dict.fromkeys(("settling_time", "recovery_time", "divergence_time"), "s")
TEXT = "study scenario plant observer observer_a observer_b signal unit metric status method reason"
TYPES = dict.fromkeys((*names(listed=True), *TEXT.split()), pa.string())
TYPES |= dict.fromkeys(("cell", "seed", "n", "diverged"), pa.int64())
TYPES |= {name + end: pa.bool_() for name in ("predicts_unknown_input", "certified") for end in ("", "_a", "_b")}


def unit_of(metric: str, unit: str) -> str:
    """Return the unit of a metric of a signal with the unit `unit`."""
    if metric in OWN_UNITS:
        return OWN_UNITS[metric]
    return f"({unit})^2" if metric.endswith("mse") and not metric.endswith("rmse") else unit


def keys(study: str, cell: "Cell") -> dict[str, object]:
    """Return the columns that identify a cell: study, scenario, cell number, axes."""
    return {"study": study, "scenario": cell.scenario.name, "cell": cell.number, **cell.values}


def metrics_shown(results: Container[str]) -> list[str]:
    """Return the metrics with a column in a table of runs; those of loops and of covariances only if they exist."""
    return [m for m in RUN_METRICS if m in results or m not in OPTIONAL]


def words(vocabulary: Sequence[str], codes: ArrayLike) -> pa.Array:
    """Return a column of texts as indices into its few different values."""
    indices = pa.array(np.asarray(codes, np.int32))
    return pa.DictionaryArray.from_arrays(indices, pa.array(vocabulary)).cast(pa.string())


def concat_columns(parts: Iterable[Mapping[str, object]]) -> dict[str, Any]:
    """Concatenate parts of a table by column; a part has one value per row, or one value for all its rows."""
    by_name: dict[str, list[object]] = {}
    lengths: list[int] = []
    for part in parts:
        for name, value in part.items():
            by_name.setdefault(name, []).append(value)
        lengths.append(next(len(value) for value in part.values() if isinstance(value, np.ndarray)))
    out: dict[str, Any] = {}
    for name, values in by_name.items():
        arrays = [value for value in values if isinstance(value, np.ndarray)]
        values_by_row = itertools.chain.from_iterable(map(itertools.repeat, values, lengths))
        out[name] = np.concatenate(arrays) if arrays else list(values_by_row)
    return out


def with_intervals(rows: pa.Table) -> pa.Table:
    """Return a table whose metadata describe its intervals."""
    return rows.replace_schema_metadata({**rows.schema.metadata, "pcbench.intervals": INTERVALS})


def table(columns: Columns, bools: tuple[str, ...] = ()) -> pa.Table:
    """Return a table with types, units and meanings by column name; NaN becomes null."""
    arrays, fields = [], []
    for name, values in columns.items():
        if isinstance(values, list) and list in set(map(type, values)):
            values = [v if isinstance(v, list) else [v] for v in values]  # channels that differ in one cell
        if not isinstance(values, pa.Array):
            has_lists = isinstance(values, list) and any(isinstance(v, list) for v in values[:1])
            kind = TYPES.get(name) or (pa.list_(pa.float64()) if has_lists else pa.float64())
            values = _array(values, pa.bool_() if name in bools else kind)
        arrays.append(values)
        fields.append(_field(name, values.type))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={"pcbench.schema": SCHEMA}))


def has_schema(metadata: Mapping[bytes, bytes]) -> bool:
    """Return whether a table with this metadata has the columns of this release."""
    return metadata.get(b"pcbench.schema") == SCHEMA.encode()


@cache
def _field(name: str, kind: pa.DataType) -> pa.Field:
    unit = AXIS_UNITS.get(name, "s" if OWN_UNITS.get(name) == "s" else "")
    about = {"meaning": MEANING.get(name, "plant parameter at this grid point")} | ({"unit": unit} if unit else {})
    return pa.field(name, kind, metadata=about)


def _array(values: ArrayLike, kind: pa.DataType) -> pa.Array:
    """Values as a column; NaN becomes null."""
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        return pa.array(values, kind, from_pandas=True)
    is_nan = np.isnan(values)  # four times as fast as `pa.array`
    valid = pa.py_buffer(np.packbits(~is_nan, bitorder="little")) if is_nan.any() else None
    return pa.Array.from_buffers(kind, len(values), [valid, pa.py_buffer(np.ascontiguousarray(values, float))])


def axes_of(row: Iterable[str]) -> list[str]:
    """Return the axis columns among a row's keys, in order."""
    return [name for name in row if name in AXIS_UNITS or name.startswith("plant.")]


def stats_order(axes: list[str]) -> list[str]:
    """Return the columns of stats.parquet."""
    head = "study scenario plant observer cell"
    identity = "signal unit predicts_unknown_input certified metric method n diverged"
    quantiles = [q + end for q in QUANTILES for end in ("", "_low", "_high")]
    return [*head.split(), *axes, *identity.split(), "mean", "se", "ci_low", "ci_high", *quantiles, "reason"]


def pairs_order(axes: list[str]) -> list[str]:
    """Return the columns of pairs.parquet."""
    pair = "observer_a observer_b predicts_unknown_input_a predicts_unknown_input_b certified_a certified_b signal unit metric"
    numbers = "method n mean_diff se ci_low ci_high prob_a_better p_value p_holm"
    return ["study", "scenario", "plant", "cell", *axes, *pair.split(), *numbers.split()]
