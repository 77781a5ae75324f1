"""What a person reads of two results of one study: what changed beyond its interval, the most sure first."""

from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from pcbench.cli.render.tables import titled
from pcbench.dataset.compare import Comparison
from pcbench.statistics.number_format import UNPROVEN, marked

LONGEST = 40  # rows; the rest is counted


def comparison(found: Comparison, a: str, b: str, console: Console) -> None:
    """Print what differs in how two results were made, what changed beyond its interval, and what to make of the rest."""
    for phrase in found.made_by:
        console.print(phrase, highlight=False, markup=False)
    moved = found.rows[found.rows.changed]
    if len(moved):
        _rows(moved.head(LONGEST), f"changed beyond its interval: {a} there, {b} here", console)
    if len(moved) > LONGEST:
        console.print(f"... and {len(moved) - LONGEST:,} rows more that changed.", highlight=False)
    for side, many in zip((a, b), found.only, strict=True):
        if many:
            console.print(f"{many:,} rows stand in {side} alone.", highlight=False, markup=False)
    console.print(_drawn(found.rows, found), highlight=False)
    console.print(f"{found.changed:,} of {len(found.rows):,} rows changed beyond their interval.", highlight=False)


def _drawn(rows: pd.DataFrame, found: Comparison) -> str:
    """What stands on the same draws, and how equal it is."""
    same = int(rows.same_draws.sum())
    if not same:
        return f"All {len(rows):,} rows stand on other draws: compared by Welch's t, Holm over all of them, 5 %."
    equal = "bit for bit equal" if found.identical else f"apart by at most {found.largest:.1e} of themselves"
    equal += f", {int(rows.narrowed.sum()):,} of them over the seeds that both hold" if rows.narrowed.any() else ""
    rest = f"; {len(rows) - same:,} on other draws, compared by Welch's t" if same < len(rows) else ""
    return f"{same:,} rows stand on the same draws: {equal}{rest}."


def _rows(rows: pd.DataFrame, title: str, console: Console) -> None:
    table = titled(title)
    for head in ("scenario", "cell", "observer", "signal", "metric"):
        table.add_column(head, overflow="fold")
    for head in ("there", "here", "difference", "p (Holm)"):
        table.add_column(head, justify="right")
    records: list[dict[str, Any]] = rows.to_dict("records")  # type: ignore[assignment]
    for r in records:
        sides = [_mean(r[f"mean_{side}"], r[f"se_{side}"], r["unit"]) for side in "ab"]
        p = "no spread" if np.isnan(r["p_holm"]) else f"{r['p_holm']:.1e}"
        observer = marked(r["observer"], [r["certified_a"], r["certified_b"]])
        words = (r["scenario"], r["where"], observer, r["signal"], r["metric"])
        table.add_row(*words, *sides, f"{r['difference']:+.3g}", p)
    console.print(table)
    if rows[["certified_a", "certified_b"]].isin([False]).to_numpy().any():
        console.print(f"{UNPROVEN} its gains.", highlight=False)


def _mean(mean: float, se: float, unit: str) -> str:
    if np.isnan(mean):
        return "-"
    return f"{mean:.5g}" + (f" ± {2 * se:.1g}" if se > 0 else "") + (f" {unit}" if unit else "")
