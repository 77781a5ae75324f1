"""What a person reads of a tuning on a log: intensities with their intervals, and what is held out."""

from typing import Any

import numpy as np
from rich.console import Console

from pcbench.cli.render.tables import Column, printed

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
