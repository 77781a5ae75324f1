"""Rows of stats and pairs of several cells as columns, and the table of one observer's runs in one cell.

Values that the rows of a cell share are stored once. The table of runs has one row per seed and signal.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench.dataset import columns
from pcbench.dataset.columns import Columns, words
from pcbench.statistics import COLUMNS, ESTIMATED, VERDICT, ObserverSummary, Pair, PairResult, Results

Head = dict[str, object]  # the common values of the rows of a cell, by column
Facts = list[dict[str, dict[str, bool | None]]]  # [C] true, false or null for each observer, by column
Signals = Sequence[tuple[str, str]]  # name and unit
Indices = NDArray[np.int64]


def stats_table(
    heads: list[Head], facts: Facts, signals: Signals, by_observer: Mapping[str, ObserverSummary]
) -> pa.Table:
    """Return the rows of stats, by cell, observer, signal and metric."""
    summaries = list(by_observer.values())
    mask = np.concatenate([d.exists for d in summaries], 1)
    values = np.concatenate([d.values for d in summaries], 1)[mask]
    cells, row = np.nonzero(mask)
    observer = np.repeat(np.arange(len(summaries)), [len(d.names) for d in summaries])[row]
    names = [name for d in summaries for name in d.names]
    out = {"observer": words(list(by_observer), observer)} | _of_rows(names, signals, row)
    out |= _of_observers(facts, list(by_observer), cells, observer)
    numbers = {
        "n": np.concatenate([d.n for d in summaries])[row],
        "diverged": np.array([d.diverged for d in summaries])[observer],
    }
    numbers |= dict(zip((*ESTIMATED, *COLUMNS), values.T, strict=True))
    return _table(heads, cells, out | numbers, columns.stats_order(columns.axes_of(heads[0])))


def pairs_table(heads: list[Head], facts: Facts, signals: Signals, by_pair: Mapping[Pair, PairResult]) -> pa.Table:
    """Return the rows of pairs, by cell, pair of observers, signal and compared metric."""
    results, names = list(by_pair.values()), [name for j in by_pair.values() for name in j.names]
    cells, row = np.divmod(np.arange(len(heads) * len(names)), max(len(names), 1))
    pair = np.repeat(np.arange(len(results)), [len(j.names) for j in results])[row]
    out = _of_rows(names, signals, row)
    for side, observers in zip("ab", zip(*by_pair, strict=True) if by_pair else ((), ()), strict=True):
        out[f"observer_{side}"] = words(observers, pair)
        out |= {f"{key}_{side}": column for key, column in _of_observers(facts, observers, cells, pair).items()}
    values = np.concatenate([j.values for j in results], 1) if results else np.zeros((len(heads), 0, len(VERDICT)))
    numbers = {"n": np.array([j.n for j in results], np.int64)[pair]}
    numbers |= dict(zip(VERDICT, values.reshape(-1, len(VERDICT)).T, strict=True))
    return _table(heads, cells, out | numbers, columns.pairs_order(columns.axes_of(heads[0])))


def _table(heads: list[Head], cells: Indices, values: Columns, order: list[str]) -> pa.Table:
    """Rows with their columns in the given order: the index of each row's cell, and the other columns."""
    heads_table = columns.table({name: [head[name] for head in heads] for name in order if name not in values})
    cell_rows = heads_table.take(pa.array(cells))
    common = {name: cell_rows[name].combine_chunks() for name in heads_table.column_names}
    return columns.with_intervals(columns.table({name: common.get(name, values.get(name)) for name in order}))


def _of_rows(names: Sequence[tuple[str, int]], signals: Signals, row: Indices) -> dict[str, pa.Array]:
    """The columns that identify a row; `names` are (metric, signal)."""
    texts = {
        "signal": [signals[i][0] for _, i in names],
        "unit": [columns.unit_of(metric, signals[i][1]) for metric, i in names],
        "metric": [metric for metric, _ in names],
    }
    return {name: pa.array(column, pa.string()).take(pa.array(row)) for name, column in texts.items()}


def _of_observers(facts: Facts, observers: Sequence[str], cells: Indices, observer: Indices) -> dict[str, pa.Array]:
    """Columns of true, false or null, for each row by its cell and its observer."""
    out, index = {}, pa.array(cells * len(observers) + observer)
    for name in ("predicts_unknown_input", "certified"):
        out[name] = pa.array([f[o][name] for f in facts for o in observers], pa.bool_()).take(index)
    return out


def common_columns(head: Head, seeds: Indices, signals: Signals) -> dict[str, pa.Array]:
    """Return the shared columns of the tables of a cell's runs, one row per seed and signal; `head` has the keys."""
    # without scenario and observer, which are in the path
    row = columns.table({name: [value] for name, value in head.items() if name != "scenario"})
    (names, units), index = zip(*signals, strict=True), np.tile(np.arange(len(signals)), len(seeds))
    out = {name: pa.repeat(row[name][0], len(index)) for name in row.column_names}
    seed_column = pa.array(np.repeat(seeds, len(signals)), pa.int64())
    return out | {"seed": seed_column, "signal": words(names, index), "unit": words(units, index)}


def runs_table(common: Mapping[str, pa.Array], results: Results, predicts_unknown_input: bool | None) -> pa.Table:
    """Return the runs of one observer in one cell, with the `common_columns` of the signals that it estimates."""
    n_signals, seeds = results["mae"].shape
    diverged = np.broadcast_to(results["diverged"], results["unsettled"].shape)
    numbers = {}
    for m in columns.metrics_shown(results):
        column = np.full((n_signals, seeds), np.nan)  # null of signals that do not have it
        if m in results:
            column[: len(results[m])] = results[m]
        numbers[m] = column.T.ravel()
    values = {
        "predicts_unknown_input": pa.repeat(pa.scalar(predicts_unknown_input, pa.bool_()), n_signals * seeds),
        **numbers,
        "status": words(("settled", "unsettled", "diverged"), np.where(diverged, 2, results["unsettled"]).T.ravel()),
        "diverged": np.repeat(results["diverged"], n_signals),
        "divergence_time": np.repeat(results["divergence_time"], n_signals),
    }
    return columns.table({**common, **values}, bools=("diverged",))
