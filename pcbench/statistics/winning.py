"""Who wins a cell, and how surely. No jax."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pcbench.statistics.description import columns
from pcbench.statistics.estimates import wilson

ALPHA = 0.05


class Standing(NamedTuple):
    """How observers stand in a cell."""

    order: tuple[str, ...]  # the best first: the fewest diverged runs, and then the least mean
    alike: tuple[str, ...]  # of the others, those that the best is not surely better than
    p_value: float  # the largest of Holm's adjusted p-values of the best against another; NaN: there is no test
    factor: float  # the second mean over the best; NaN: there is none

    @property
    def winner(self) -> str:
        """Return the best where it is surely so; empty where it is not."""
        return self.order[0] if self.order and not self.alike else ""


def standing(rows: pd.DataFrame, pairs: pd.DataFrame) -> Standing:
    """Return how observers stand in a cell.

    `rows` are those of stats of one metric in the cell, `pairs` those of pairs. The best is surely better than another that
    surely diverges more often (Wilson's intervals are apart) or is worse by Holm's adjusted p-value; where several runs
    do not vary, and of exact numbers (n = 0), there is no test, and a difference is one. No observer is the best where all
    have diverged.
    """
    order = ranked(rows)
    best, others = order.iloc[0], order.iloc[1:]
    if not np.isfinite(best["mean"]):
        return Standing(tuple(order.observer), tuple(order.observer), np.nan, np.nan)
    alike = [str(o["observer"]) for o in others.to_dict("records") if not _apart(pairs, best, o)]
    met = pairs[(pairs.observer_a == best.observer) | (pairs.observer_b == best.observer)].p_holm
    second = float(others["mean"].iloc[0]) if len(others) else np.nan
    factor = second / float(best["mean"]) if best["mean"] > 0 else np.inf if second > 0 else np.nan
    return Standing(tuple(map(str, order.observer)), tuple(alike), float(met.max()) if len(met) else np.nan, factor)


def ranked(rows: pd.DataFrame) -> pd.DataFrame:
    """Return rows of one metric and cell, the best first: the fewest diverged runs, then the least mean."""
    return rows.sort_values(["diverged", "mean"], kind="stable", na_position="last")


def winner(rows: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return the observer that wins a cell; empty where the best is no surer than 5 %."""
    return standing(rows, pairs).winner


def diverges_more(best: Any, other: Any) -> bool:
    """Say whether one row of stats surely has more diverged runs than another."""
    high, low = (fraction_of(int(row["diverged"]), int(row["n"])) for row in (best, other))
    return bool(low["ci_low"] > high["ci_high"])


def fraction_of(diverged: int, kept: int) -> dict[str, float]:
    """Return the share of runs that diverged, with Wilson's interval."""
    return columns(wilson(np.array([diverged]), diverged + kept))[0]


def _apart(pairs: pd.DataFrame, best: Any, other: Any) -> bool:
    if diverges_more(best, other):
        return True
    names = {best.observer, other["observer"]}
    row = pairs[pairs.observer_a.isin(names) & pairs.observer_b.isin(names)]
    if row.empty:
        return False
    p, alike = float(row.p_holm.iloc[0]), float(row.prob_a_better.iloc[0]) == 0.5
    several, sign = int(row.n.iloc[0]) != 1, 1 if row.observer_a.iloc[0] == best.observer else -1
    if sign * float(row.mean_diff.iloc[0]) > 0:  # fewer runs diverged, not surely, and the others are worse
        return False
    return several and not alike if np.isnan(p) else p <= ALPHA
