"""Who wins a cell, and how surely. No jax."""

from typing import Any

import numpy as np
import pandas as pd

from pcbench.statistics.description import columns
from pcbench.statistics.estimates import wilson

ALPHA = 0.05


def winner(rows: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Return the observer that wins a cell; empty where the best is no surer than 5 %.

    `rows` are those of stats of one metric in the cell, `pairs` those of pairs. The best has the fewest diverged runs and then
    the least mean. It wins where every other observer surely diverges more often (Wilson's intervals are apart) or differs from
    it by Holm's adjusted p-value; where several runs do not vary there is no test, and a difference is one. No observer wins
    where all have diverged.
    """
    order = rows.sort_values(["diverged", "mean"], kind="stable")
    best, others = order.iloc[0], order.iloc[1:]
    surely = bool(np.isfinite(best["mean"])) and all(_apart(pairs, best, o) for o in others.to_dict("records"))
    return str(best.observer) if surely else ""


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
    several = int(row.n.iloc[0]) > 1
    return several and not alike if np.isnan(p) else p <= ALPHA
