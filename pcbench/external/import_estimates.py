"""Estimates that somebody made elsewhere: a table with a row for each tick of each run, checked against what a study asks."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pcbench.errors import UserError, short, unknown

KEYS = ("scenario", "cell", "seed", "tick")
Floats = NDArray[np.float64]


def read(file: str | Path) -> pd.DataFrame:
    """Return the table of a Parquet or CSV file; raise UserError where there is none."""
    path = Path(file).expanduser()
    try:
        if path.suffix == ".csv":
            return pd.read_csv(path)
        return pd.read_parquet(path, partitioning=None)
    except (OSError, ValueError, pd.errors.ParserError) as error:
        raise UserError(
            f"{short(str(file))}: cannot be read ({short(str(error).splitlines()[0])}), expected a Parquet file, or a .csv; "
            "give one."
        ) from None


def sorted_(
    table: pd.DataFrame, where: str, signals: list[str], only: tuple[str, int] | None
) -> dict[tuple[str, int], Any]:
    """Return the rows of each cell, in the order of seeds and ticks; of a study of `only` one cell its names may be left out.

    Raises UserError for a column that is missing or holds no numbers.
    """
    if only:
        table = table.copy()
        table["scenario"] = table.get("scenario", only[0])
        table["cell"] = table.get("cell", only[1])
    for name in KEYS:
        if name not in table:
            raise (
                unknown(where, "column of it", name, table.columns.astype(str))
                if len(table.columns)
                else UserError(f"{where}: got no columns, expected {', '.join(KEYS)} and the signals; write them.")
            )
    if not set(signals) & set(table.columns):
        raise UserError(
            f"{where}: got the columns {short(', '.join(map(str, table.columns)))}, expected one for each signal, "
            f"{', '.join(signals)}; write the estimates under these names."
        )
    for name in [*KEYS[1:], *(s for s in signals if s in table)]:
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise UserError(f"{where}: column {name} got {table[name].dtype}, expected numbers; write them as such.")
    ordered = table.sort_values(list(KEYS), kind="stable")
    groups: Any = ordered.groupby(["scenario", "cell"], sort=False)
    return {(str(s), int(c)): rows for (s, c), rows in groups}


def of_cell(rows: Any, where: str, signals: list[str], seeds: NDArray[np.int64], ticks: int) -> Floats:
    """Return the estimates of a cell's runs, [seeds, ticks, signals]; raise UserError for runs or ticks that are not all there.

    What a plant has of unknowns may be left out, all of it: of the last signals.
    """
    if rows is None:
        raise UserError(f"{where}: got no rows, expected {len(seeds)} runs of {ticks:,} ticks; estimate them all.")
    there = rows[rows.tick < ticks]
    names = [s for s in signals if s in there]
    if names != signals[: len(names)]:
        lack = next(s for s in signals if s not in names)
        raise UserError(f"{where}: got no column '{lack}', expected every state; write it.")
    counts = there.groupby("seed").tick.agg(["size", "nunique", "min", "max"]).reindex(seeds)
    missing = counts.index[counts["size"].isna()]
    if len(missing):
        raise UserError(
            f"{where}: got {len(seeds) - len(missing)} of {len(seeds)} runs (seed {missing[0]} is missing), expected all; "
            "estimate them too: differences are paired run by run."
        )
    wrong = counts[(counts["size"] != ticks) | (counts["nunique"] != ticks) | (counts["min"] != 0)]
    if len(wrong):
        raise UserError(
            f"{where}: got {int(wrong['size'].iloc[0]):,} ticks of seed {wrong.index[0]}, expected each of 0 .. {ticks - 1:,} "
            "once; leave a row for every tick."
        )
    mine = there[there.seed.isin(seeds)]
    found: Floats = mine[names].to_numpy(float).reshape(len(seeds), ticks, len(names))
    return found
