"""Rows of stats and pairs of several cells as columns: what a cell's rows have in common is said once.

The table of one observer's runs in one cell: a row per seed and signal.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench.dataset import columns, loop_columns
from pcbench.dataset.columns import table, words
from pcbench.statistics import COLUMNS, ESTIMATED, VERDICT, Described, Judged, Pair

Head = dict[str, Any]  # what rows have in common, by column
Known = list[dict[str, Head]]  # [C] what is known of each observer in a cell: KNOWN
KNOWN = ("predicts_unknown_input", "certified")


class Frame(NamedTuple):
    """The rows of C cells, one cell after the other."""

    heads: list[Head]  # [C]
    many: NDArray[np.int64]  # [C] rows of each
    columns: dict[str, Any]  # what is not in heads: arrays of numbers, or of pyarrow

    def table(self, order: list[str]) -> pa.Table:
        """Return the rows as a table with its columns in the given order; its metadata say what intervals are."""
        said = columns.table({name: [head[name] for head in self.heads] for name in order if name not in self.columns})
        row = pa.array(np.repeat(np.arange(len(self.heads)), self.many))
        common = {name: column.chunk(0).take(row) for name, column in zip(said.column_names, said.columns, strict=True)}
        return columns.with_intervals(columns.table({name: (common | self.columns)[name] for name in order}))


def of_stats(
    heads: list[Head], known: Known, signals: tuple[tuple[str, str], ...], found: dict[str, Described]
) -> Frame:
    """Return the rows of stats: by cell, by observer, by signal, every metric."""
    each = list(found.values())
    shown = np.concatenate([d.shown for d in each], 1)
    values = np.concatenate([d.values for d in each], 1)[shown]
    cells, row = np.nonzero(shown)
    who = np.repeat(np.arange(len(each)), [len(d.names) for d in each])[row]
    names = [name for d in each for name in d.names]
    out = (
        {"observer": columns.words(list(found), who)}
        | _named(names, signals, row)
        | _known(known, list(found), cells, who)
    )
    out |= {"n": np.concatenate([d.n for d in each])[row], "diverged": np.array([d.diverged for d in each])[who]}
    out |= dict(zip((*ESTIMATED, *COLUMNS), values.T, strict=True))
    return Frame(heads, shown.sum(1), out)


def of_pairs(heads: list[Head], known: Known, signals: tuple[tuple[str, str], ...], found: dict[Pair, Judged]) -> Frame:
    """Return the rows of pairs: by cell, by pair of observers, by signal, every metric that is compared."""
    each, names = list(found.values()), [name for j in found.values() for name in j.names]
    row = np.tile(np.arange(len(names)), len(heads))
    cells = np.repeat(np.arange(len(heads)), len(names))
    which = np.repeat(np.arange(len(each)), [len(j.names) for j in each])[row]
    out = _named(names, signals, row)
    for side, observers in zip("ab", zip(*found, strict=True) if found else ((), ()), strict=True):
        out[f"observer_{side}"] = columns.words(observers, which)
        mine = _known(known, list(observers), cells, which)
        out |= {f"{what}_{side}": column for what, column in mine.items()}
    values = np.concatenate([j.values for j in each], 1) if each else np.zeros((len(heads), 0, len(VERDICT)))
    out |= {"n": np.array([j.n for j in each], np.int64)[which]}
    out |= dict(zip(VERDICT, values.reshape(-1, len(VERDICT)).T, strict=True))
    return Frame(heads, np.full(len(heads), len(names)), out)


def _named(
    names: Sequence[tuple[str, int]], signals: tuple[tuple[str, str], ...], row: NDArray[np.int64]
) -> dict[str, pa.Array]:
    """The columns that say what a row is of; `names` are (metric, signal)."""
    said = {
        "signal": [signals[i][0] for _, i in names],
        "unit": [columns.unit_of(metric, signals[i][1]) for metric, i in names],
        "metric": [metric for metric, _ in names],
    }
    out = {}
    for what, each in said.items():
        known = list(dict.fromkeys(each))
        out[what] = columns.words(known, np.array([known.index(word) for word in each], np.int32)[row])
    return out


def _known(known: Known, observers: list[str], cells: NDArray[np.int64], who: NDArray[np.int64]) -> dict[str, pa.Array]:
    """Columns of yes, no or null: of which cell and which of the observers each row is."""
    out = {}
    for what in KNOWN:
        said = [[2 if each[o][what] is None else int(each[o][what]) for o in observers] for each in known]
        mine = np.array(said, int)[cells, who]
        out[what] = pa.array(mine == 1, pa.bool_(), mask=mine == 2)
    return out


def common_columns(
    head: dict[str, Any], seeds: NDArray[np.int64], signals: tuple[tuple[str, str], ...]
) -> dict[str, pa.Array]:
    """Return what tables of runs of a cell have in common, whose `keys` are in `head`: a row per seed and signal."""
    said = table({name: [value] for name, value in head.items() if name != "scenario"})  # in the path, as `observer` is
    (names, units), at = zip(*signals, strict=True), np.tile(np.arange(len(signals)), len(seeds))
    out = {name: pa.repeat(column[0], len(at)) for name, column in zip(said.column_names, said.columns, strict=True)}
    rows = pa.array(np.repeat(seeds, len(signals)), pa.int64())
    return out | {"seed": rows, "signal": words(names, at), "unit": words(units, at)}


def runs_table(common: dict[str, pa.Array], results: dict[str, Any], predicts_unknown_input: bool | None) -> pa.Table:
    """Return the runs of one observer in one cell, with the `common_columns` of the signals that it estimates."""
    (many, seeds), bad = results["mae"].shape, np.broadcast_to(results["diverged"], results["unsettled"].shape)
    columns = {
        "predicts_unknown_input": pa.repeat(pa.scalar(predicts_unknown_input, pa.bool_()), many * seeds),
        **{m: _column(results.get(m), many, seeds) for m in loop_columns.shown(results)},
        "status": words(("settled", "unsettled", "diverged"), np.where(bad, 2, results["unsettled"]).T.ravel()),
        "diverged": np.repeat(results["diverged"], many),
        "divergence_time": np.repeat(results["divergence_time"], many),
    }
    return table(common | columns, bools=("diverged",))


def _column(values: Any, many: int, seeds: int) -> Any:
    """A metric [signals, seeds] as a column; null of signals that it does not have."""
    out = np.full((many, seeds), np.nan)
    if values is not None:
        out[: len(values)] = values
    return out.T.ravel()
