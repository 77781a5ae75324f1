"""What a person reads of two results of one study: what changed beyond its interval, the most sure first.

What a person reads of a tuning on a log: intensities with their intervals, and what is held out.
"""

from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from pcbench.cli.render.tables import Column, printed, titled
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


VARIANCES = ("R", "Q")  # whose root is a standard deviation


def tuned(found: Any, observer: str, log: str, folder: str | None, console: Console) -> None:
    """Print the intensities, and the start against what was found on the held-out part."""
    rows = found.intensities
    columns = [
        Column("intensity", [i.name for i in rows], left=True),
        Column("start", [f"{i.start:.4g}" for i in rows]),
        Column("found", [f"{i.found:.4g}" for i in rows]),
        Column("95 % interval", [_interval(i) for i in rows]),
        Column(
            "root", [f"{i.found**0.5:.4g}" if i.name.partition("[")[0] in VARIANCES else "-" for i in rows], spare=1
        ),
    ]
    printed(f"{observer}: most likely on {log}, {len(found.points)} points by descent", columns, console)
    held = found.held_out
    columns = [
        Column("held out", list(held), left=True),
        Column("log-likelihood\nof a number", [f"{each['log_likelihood']:.4g}" for each in held.values()]),
        Column("NIS", [f"{each['nis']:.3f}" for each in held.values()]),
        Column("verdict", [each["verdict"] for each in held.values()], left=True),
        Column("p white", [f"{each['p_white']:.3g}" for each in held.values()]),
    ]
    printed(f"tuned on the first part alone: the last part, {held['tuned']['samples']} samples", columns, console)
    _print(f"tuned - start: {found.gain:+.4g} (standard error {found.gain_se:.2g}).", console)
    for sentence in found.said:
        _print(sentence, console)
    if found.kept_start:
        _print(f"The start is kept: {found.kept_start}.", console)
    if folder is not None:
        _print(
            f"Now replay it: pcbench replay {log} --plant {folder}/tuned.toml --observers {observer} --out replayed",
            console,
        )


def _interval(row: Any) -> str:
    if np.isnan(row.low):
        return "-"
    return f"{row.low:.4g} to {row.high:.4g}" if row.low else f"below {row.high:.4g}"


def summary(found: Any) -> dict[str, Any]:
    """Return what a tuning found as JSON has it."""
    out = found._asdict()
    out.pop("study")
    return out | {
        "intensities": [i._asdict() for i in found.intensities],
        "points": len(found.points),
        "method": "likelihood",
    }


def _print(text: str, console: Console) -> None:
    console.print(text, highlight=False, markup=False, soft_wrap=True)
