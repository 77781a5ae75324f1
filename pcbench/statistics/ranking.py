"""The ranking of observers at a grid point, with its significance. No jax."""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple, cast

import numpy as np
import pandas as pd

from pcbench.statistics.aggregate import Row, columns
from pcbench.statistics.confidence_intervals import wilson

ALPHA = 0.05


class Standing(NamedTuple):
    """The ranking of observers at a grid point."""

    order: tuple[str, ...]  # best first: fewest diverged runs, then smallest mean
    alike: tuple[str, ...]  # the others that are not significantly worse than the best
    p_value: float  # largest Holm-adjusted p-value of the best against another; NaN: no test
    factor: float  # second mean divided by the best; NaN: none
    leaders: tuple[str, ...] = ()  # the best and those alike; empty: all runs diverged, or no test compares them

    @property
    def winner(self) -> str:
        """Return the best if it is significantly better than all others, else an empty text."""
        return self.leaders[0] if len(self.leaders) == 1 else ""


def standing(rows: pd.DataFrame, pairs: pd.DataFrame) -> Standing:
    """Return the ranking of observers at a grid point.

    `rows` are those of stats for one metric at the grid point, `pairs` those of pairs. The best is significantly better than an
    observer that diverges significantly more often (disjoint Wilson intervals) or is worse by Holm's adjusted p-value. If
    several runs do not vary, and for exact numbers (n = 0), there is no test, and any difference counts. If all observers
    diverged, none is the best.
    """
    return standing_of(_records(rows), _records(pairs))


def standing_of(rows: list[Row], pairs: list[Row]) -> Standing:
    """Return the same from rows that are dicts, which is much faster for many grid points."""
    order = sorted(rows, key=_rank)
    best, rest, names = order[0], order[1:], tuple(str(row["observer"]) for row in order)
    if not np.isfinite(best["mean"]):
        return Standing(names, names, np.nan, np.nan)
    tests = [pair for pair in pairs if best["observer"] in (pair["observer_a"], pair["observer_b"])]
    alike = [str(o["observer"]) for o in rest if not _is_worse(tests, best, o)]
    rivals = {str(pair[side]) for pair in tests if pair["n"] != 1 for side in ("observer_a", "observer_b")}
    leaders = (names[0], *alike) if rivals.issuperset(alike) else ()
    second = float(rest[0]["mean"]) if rest else np.nan
    factor = second / float(best["mean"]) if best["mean"] > 0 else np.inf if second > 0 else np.nan
    p_values = [float(pair["p_holm"]) for pair in tests if not np.isnan(pair["p_holm"])]
    return Standing(names, tuple(alike), max(p_values, default=np.nan), factor, leaders)


def most_often(leaders: Iterable[tuple[str, ...]]) -> tuple[list[str], int]:
    """Return the observers that lead the most grid points, and how many; no observer if no grid point has leaders."""
    counts = Counter(observer for observers in leaders for observer in observers)
    most = max(counts.values(), default=0)
    return sorted(observer for observer, count in counts.items() if count == most), most


def _rank(row: Row) -> tuple[float, bool, float]:
    """Return the sort key of a row: fewest diverged runs, then smallest mean, then rows without a mean."""
    return row["diverged"], bool(np.isnan(row["mean"])), row["mean"]


def by_cell(rows: pd.DataFrame) -> dict[int, list[Row]]:
    """Return the rows of stats or pairs by grid point, in order, as input of `standing_of`."""
    out: dict[int, list[Row]] = {}
    for row in _records(rows):
        out.setdefault(row["cell"], []).append(row)
    return out


def _records(rows: pd.DataFrame) -> list[Row]:
    return cast(list[Row], rows.to_dict("records"))


def diverges_more(best: "Row | pd.Series", rival: "Row | pd.Series") -> bool:
    """Return whether one row of stats has significantly more diverged runs than another."""
    if not rival["diverged"]:
        return False
    counts = [(int(row["diverged"]), int(row["n"])) for row in (best, rival)]
    high, low = (columns(wilson(np.array([diverged]), diverged + finite))[0] for diverged, finite in counts)
    return bool(low["ci_low"] > high["ci_high"])


def _is_worse(pairs: list[Row], best: Row, rival: Row) -> bool:
    if diverges_more(best, rival):
        return True
    row = next((pair for pair in pairs if rival["observer"] in (pair["observer_a"], pair["observer_b"])), None)
    if row is None:
        return False
    p, alike = float(row["p_holm"]), float(row["prob_a_better"]) == 0.5
    several, sign = int(row["n"]) != 1, 1 if row["observer_a"] == best["observer"] else -1
    if (
        sign * float(row["mean_diff"]) > 0
    ):  # the best has fewer diverged runs, though not significantly, and a larger mean
        return False
    return several and not alike if np.isnan(p) else p <= ALPHA
