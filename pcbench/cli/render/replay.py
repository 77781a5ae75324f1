"""What comes of compiling an exported observer, as a table."""

import math
from typing import Any

from rich.console import Console

from pcbench.cli.render.tables import Column, printed


def table(found: Any, double: dict[str, Any], single: dict[str, Any], of: str, console: Console) -> None:
    """Print how far C is from a simulation or the replay `of` a recording, in both precisions, and its errors."""
    about = found.about
    signals = [(name, unit) for name, unit in about.signals if name in double]
    columns = [
        Column("signal", [f"{name} [{unit}]" for name, unit in signals], left=True),
        Column("double:\nat most off", [f"{double[name].most:.2g}" for name, _ in signals]),
        Column("rms error", [f"{double[name].error:.6g}" for name, _ in signals]),
        Column("float:\nrms off", [f"{single[name].differs:.2g}" for name, _ in signals]),
        Column("at most off", [f"{single[name].most:.2g}" for name, _ in signals], spare=1),
        Column("rms error", [f"{single[name].error:.6g}" for name, _ in signals]),
    ]
    if all(math.isnan(each.error) for each in (*double.values(), *single.values())):  # of a recording without the truth
        columns = [column for column in columns if column.head != "rms error"]
    oldest = f"oldest admissible age: {about.oldest} ticks ({about.oldest * about.dt:g} s)"
    newer = f"at most {about.newer}" if about.newer else "no"
    oldest += f", if {newer} newer measurement{'s' * (about.newer > 1)} arrived before it"
    printed(f"{about.observer} of {about.scenario} in C, on {of}; {oldest}", columns, console)
