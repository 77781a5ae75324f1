"""The table of one observer's runs in one cell: a row per seed and signal."""

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pcbench.dataset import loop_columns
from pcbench.dataset.columns import table, words


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
