"""The columns of the tables that other programs read, with units and meaning: a change is a new SCHEMA number. No jax."""

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa

from pcbench.dataset import loop_columns
from pcbench.fields import FIELDS
from pcbench.statistics import QUANTILES

SCHEMA = "1"  # of every file; one more for each change once there is a release
AXIS_UNITS = {f.name: f.unit for f in FIELDS}
MEANING = {
    "study": "name of the study",
    "scenario": "published experiment",
    "plant": "plant of the scenario",
    "observer": "observer, with the options in study.toml",
    "observer_a": "first observer of the pair",
    "observer_b": "second observer of the pair",
    "cell": "number of the combination of axis values, from 0, within its scenario",
    "seed": "seed index: with the study's root seed it addresses every random number of the run",
    "signal": "state, unknown input or parameter whose error e = x - xhat is measured",
    "predicts_unknown_input": "whether the observer's prediction to the present carries the unknown input it has "
    "found; null: it finds "
    "none, or predicts nothing",
    **{f"predicts_unknown_input_{one}": f"predicts_unknown_input of observer_{one}" for one in "ab"},
    "certified": "whether something proves the observer's gains in this cell (an inequality, checked again, with a margin "
    "above 0); null: it has no gains",
    **{f"certified_{one}": f"certified of observer_{one}" for one in "ab"},
    "unit": "unit of the signal; beside a metric, of that metric",
    "mae": "mean |e| over ticks 0 .. N-1",
    "rmse": "square root of the mean of e^2 over ticks 0 .. N-1",
    "mse": "mean of e^2 over ticks 0 .. N-1 [unit squared]",
    "max_abs_error": "largest |e| over ticks 0 .. N-1",
    "final_error": "e at tick N-1, signed",
    "settling_time": "time [s] of the last exit of |e| from the scenario's band; the horizon where it is still outside",
    "recovery_time": "time [s] from a jump of the unknown input to the last exit of |e| from its band before the next one or "
    "the horizon, the longest of all jumps from the scenario's tail start on; null where there is none",
    "steady_mae": "mean |e| from the scenario's tail start on",
    "steady_rmse": "square root of the mean of e^2 from the tail start on",
    "steady_mse": "mean of e^2 from the tail start on [unit squared]",
    "steady_max_abs_error": "largest |e| from the tail start on",
    "tracking_rmse": "root of the mean square of set point less state, in a closed loop; null of what has no set point",
    "steady_tracking_rmse": "the same from the tail start on",
    "status": "diverged; or unsettled: the error of this signal left its band after the tail had started; or settled",
    "diverged": "runs: the error became non-finite or left the scenario's divergence threshold (its metrics are null); "
    "stats: how many such runs, none of them averaged",
    "divergence_time": "time [s] at which the error of a diverged run left the divergence threshold; null elsewhere",
    "metric": "a metric of `runs`; or pooled_rmse, steady_pooled_rmse (root of the mean square over runs); or "
    "rms_efficiency (the bound over steady_pooled_rmse, against the best any causal estimator can do on average over x(0) ~ "
    "N(xhat0, P0)); or "
    "divergence_rate, the fraction of runs that diverged; or unsettled_rate, the fraction of the others whose error left its "
    "band in the tail (both with Wilson's interval); or " + loop_columns.CONSISTENCY,
    "method": "runs: an estimate over simulated runs; exact: the expected value over all noise, whose se is 0 (or of schedules "
    "alone, where runs draw their own); none: neither, and `reason` says why",
    "reason": "why a number is missing that only runs have; null where it is there",
    "t": "time [s]",
    "std": "standard deviation of the error e at t, over all noise; `mean` is its mean",
    "n": "runs that enter the number; of an exact one 0, or the schedules that it is averaged over",
    "mean": "estimate over runs, or exact",
    "se": "its standard error",
    "ci_low": "lower end of its 95 % interval over seeds",
    "ci_high": "upper end of its 95 % interval over seeds",
    "mean_diff": "mean of metric(a) - metric(b) over common draws on which neither diverged: negative where a is better",
    "prob_a_better": "fraction of runs in which a is better; a tie (equal to 1e-9) counts half, a diverged run loses",
    "p_value": "two-sided paired t-test of mean_diff = 0; null where the runs do not vary",
    "p_holm": "p_value with Holm's correction over the study's comparisons of this scenario, signal and metric",
} | loop_columns.MEANING
MEANING |= {f.name: f.meaning for f in FIELDS}
MEANING |= {q: f"{int(q[1:])} % quantile over runs" for q in QUANTILES}
MEANING |= {f"{q}_low": f"lower end of the 95 % interval of {q}; null: open" for q in QUANTILES}
MEANING |= {f"{q}_high": f"upper end of the 95 % interval of {q}; null: open" for q in QUANTILES}
INTERVALS = (
    "95 %, over seeds. Means and root mean squares of what cannot be negative: Student's of the logarithm, that is "
    "mean exp(-+ t se / mean); final and mean_diff, which have a sign: Student's; fractions: Wilson's; quantiles: Nyblom's of "
    "order statistics"
)
TEXT = {
    "sampling_pattern",
    "study",
    "scenario",
    "plant",
    "observer",
    "observer_a",
    "observer_b",
    "signal",
    "unit",
    "metric",
}
TEXT |= {"status", "method", "reason", "delay_values", "delay_sequence", "delay_weights"}
WHOLE = {"cell", "seed", "n"}
YES_OR_NO = {name + end for name in ("predicts_unknown_input", "certified") for end in ("", "_a", "_b")}
SECONDS = {"settling_time", "recovery_time", "divergence_time"}


def unit_of(metric: str, unit: str) -> str:
    """Return the unit of a metric of a signal that is measured in `unit`."""
    if metric in SECONDS:
        return "s"
    if metric in loop_columns.UNITS:
        return loop_columns.UNITS[metric]
    return f"({unit})^2" if metric.endswith("mse") and not metric.endswith("rmse") else unit


def keys(study: str, cell: Any) -> dict[str, Any]:
    """Return the columns that name a cell: study, scenario, cell number, axes."""
    return {"study": study, "scenario": cell.scenario.name, "cell": cell.number, **cell.values}


def words(known: tuple[str, ...] | list[str], which: Any) -> pa.Array:
    """Return a column of few words: which of the known ones stands in each row."""
    return pa.DictionaryArray.from_arrays(_array(np.asarray(which, np.int32), pa.int32()), pa.array(known)).cast(
        pa.string()
    )


def together(parts: Iterable[dict[str, list[Any]]]) -> dict[str, list[Any]]:
    """Return parts of a table, by column, as one."""
    whole: dict[str, list[Any]] = {}
    for part in parts:
        for name, values in part.items():
            whole.setdefault(name, []).extend(values)
    return whole


def with_intervals(found: pa.Table) -> pa.Table:
    """Return a table whose metadata say what intervals are."""
    return found.replace_schema_metadata({**found.schema.metadata, "pcbench.intervals": INTERVALS})


def table(columns: dict[str, Any], bools: tuple[str, ...] = ()) -> pa.Table:
    """Return a table with types, units and meanings fixed by column name; NaN is null."""
    arrays, fields = [], []
    for name, values in columns.items():
        if isinstance(values, pa.Array):
            kind = values.type
        else:
            if isinstance(values, list) and list in set(map(type, values)):
                values = [v if isinstance(v, list) else [v] for v in values]  # channels that differ in one cell
            kind = _type(name, values, bools)
            values = _array(values, kind)
        arrays.append(values)
        fields.append(_field(name, kind))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={"pcbench.schema": SCHEMA}))


def has_schema(metadata: dict[bytes, bytes]) -> bool:
    """Return whether a table with this metadata has the columns of this release."""
    return metadata.get(b"pcbench.schema") == SCHEMA.encode()


@cache
def _field(name: str, kind: pa.DataType) -> pa.Field:
    unit = AXIS_UNITS.get(name, "s" if name in SECONDS else "")
    about = {"meaning": MEANING.get(name, "the plant's parameter in this cell")} | ({"unit": unit} if unit else {})
    return pa.field(name, kind, metadata=about)


def _array(values: Any, kind: pa.DataType) -> pa.Array:
    """Values as a column; NaN is null."""
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        return pa.array(values, kind, from_pandas=True)
    bad = np.isnan(values)  # four times as fast as `pa.array`
    known = pa.py_buffer(np.packbits(~bad, bitorder="little")) if bad.any() else None
    return pa.Array.from_buffers(kind, len(values), [known, pa.py_buffer(np.ascontiguousarray(values, float))])


def _type(name: str, values: Any, bools: tuple[str, ...]) -> pa.DataType:
    if name in bools or name in YES_OR_NO:
        return pa.bool_()
    if name in TEXT:
        return pa.string()
    if name in WHOLE or name == "diverged":
        return pa.int64()
    return pa.list_(pa.float64()) if any(isinstance(v, list) for v in values[:1]) else pa.float64()


def axes_of(row: dict[str, Any]) -> list[str]:
    """Return the axis columns among a row's keys, in order."""
    return [name for name in row if name in AXIS_UNITS or name.startswith("plant.")]


def stats_order(axes: list[str]) -> list[str]:
    """Return the columns of stats.parquet."""
    head = [
        "study",
        "scenario",
        "plant",
        "observer",
        "cell",
        *axes,
        "signal",
        "unit",
        "predicts_unknown_input",
        "certified",
    ]
    return [
        *head,
        "metric",
        "method",
        "n",
        "diverged",
        "mean",
        "se",
        "ci_low",
        "ci_high",
        *(q + end for q in QUANTILES for end in ("", "_low", "_high")),
        "reason",
    ]


def pairs_order(axes: list[str]) -> list[str]:
    """Return the columns of pairs.parquet."""
    head = [
        "study",
        "scenario",
        "plant",
        "cell",
        *axes,
        "observer_a",
        "observer_b",
        "predicts_unknown_input_a",
        "predicts_unknown_input_b",
        "certified_a",
        "certified_b",
    ]
    head += ["signal", "unit", "metric", "method"]
    return [*head, "n", "mean_diff", "se", "ci_low", "ci_high", "prob_a_better", "p_value", "p_holm"]
