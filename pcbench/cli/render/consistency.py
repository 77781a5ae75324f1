"""Which observers know how wrong they are: in a column of the closing table, and in one of their own."""

from collections import Counter
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from pcbench.cli.render.tables import Column, printed
from pcbench.statistics.consistency import BANDS, Band, exact_band, verdict

HEAD = "signal_nees"
SHOWN = ("nees", "nis")
LONGEST = 24  # rows; beyond, verdicts are counted
MEANS = (
    "nees is the squared error over what the observer believes, nis the same of samples beyond what it expected; beside them "
    "where they lie in 95 of 100 studies if it is right."
)


def judged(wide: Any, observer: str, metric: str) -> str:
    """Return a mean normalised square with its verdict, of rows by observer and metric; empty where there is none."""
    if (observer, metric) not in wide.index or np.isnan(found := wide.loc[(observer, metric), "mean"]):
        return ""
    return f"{found:.3g} {verdict(found, _band(wide, observer, metric))}"


def said(name: str, stats: pd.DataFrame, console: Console) -> list[str]:
    """Print whether errors and samples are what observers with a covariance believe; return what a reader has to know."""
    part = stats[stats.metric.isin([*SHOWN, *(BANDS[m] for m in SHOWN)])]
    cells = [(cell, _by_observer(rows)) for cell, rows in part.groupby("cell", sort=False)]
    found = [(cell, o, wide) for cell, wide in cells for o in dict.fromkeys(wide.index.get_level_values("observer"))]
    if not any(judged(wide, o, metric) for _, o, wide in found for metric in SHOWN):
        return []
    if len(found) > LONGEST:
        columns = _counted(found)
    else:
        columns = [Column("observer", [o for _, o, _ in found], left=True)]
        columns += [Column(m, [_with_band(wide, o, m) for _, o, wide in found], left=True) for m in SHOWN]
        if len(cells) > 1:
            columns.insert(0, Column("cell", [str(cell) for cell, _, _ in found]))
    printed(f"{name}: who knows how wrong it is", [c for c in columns if any(c.cells)], console)
    return [MEANS]


def _counted(found: list[tuple[Any, str, Any]]) -> list[Column]:
    """In how many cells each observer's errors, and its samples, are what."""
    names = list(dict.fromkeys(o for _, o, _ in found))
    columns = [Column("observer", names, left=True)]
    for metric in SHOWN:
        words = {o: Counter(judged(w, o, metric).partition(" ")[2] for _, one, w in found if one == o) for o in names}
        each = [", ".join(f"{word} {n}" for word, n in words[o].most_common() if word) for o in names]
        columns.append(Column(f"{metric}: cells", each, left=True))
    return columns


def _by_observer(rows: pd.DataFrame) -> Any:
    return rows.drop_duplicates(["observer", "metric"]).set_index(["observer", "metric"])


def _with_band(wide: Any, observer: str, metric: str) -> str:
    band, text = _band(wide, observer, metric), judged(wide, observer, metric)
    return text if not text or band == exact_band() else f"{text} ({band.low:.3g} .. {band.high:.3g})"


def _band(wide: Any, observer: str, metric: str) -> Band:
    """Where the mean lies of a true covariance; of what is exact at 1."""
    if (observer, BANDS[metric]) not in wide.index:
        return exact_band()
    row = wide.loc[(observer, BANDS[metric])]
    return Band(row["ci_low"], row["ci_high"])
