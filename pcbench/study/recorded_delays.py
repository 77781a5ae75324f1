"""Delays of a log in a study: `delay = "from:flight"` stands for what its samples' delays and losses were.

They are drawn from the log: MANY delays, each from the middle of an equal part of them, become `delay` and `delay_steps`.
They occur as often, and as often one after the other, as in the log (`delay_stay`); `loss` is the share that never arrived. So
the resolved study holds numbers alone, and needs no log. All in whole ticks.
Not claimed: that delays depend on no more than the one before, nor that losses come one by one, as a study draws them.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError, shown
from pcbench.logs import reading

FROM = "from:"
MANY = 16  # parts
MOST = 1 - 1e-6  # probability of a chain to stay
DIGITS = 12  # of a second
TAKEN = ("delay_steps", "delay_stay", "delay_jitter", "loss")  # what a log says, which a table may not say too


def resolved(table: dict[str, Any], where: str, folder: Path | None, tick: float) -> dict[str, Any]:
    """Return a study's table with the delays of the log that it names; as it is where it names none."""
    asked = table.get("delay")
    if not (isinstance(asked, str) and asked.startswith(FROM)):
        return table
    for key in TAKEN:
        if table.get(key):
            raise UserError(
                f"{where}.{key}: got {shown(table[key])} beside the delays of a log, expected one; leave it out."
            )
    name = Path(asked.removeprefix(FROM))
    log = reading.opened(name if folder is None else folder / name)
    batches = list(log.measurements())
    sampled, arrived = (np.concatenate([getattr(b, c) for b in batches]) for c in ("sampled", "arrived"))
    order = np.argsort(sampled, kind="stable")
    late = np.rint((arrived - sampled)[order] / tick)
    came = late[~np.isnan(late)]
    if not came.size:
        raise UserError(
            f"{where}.delay: got the log {name}, in which nothing arrived, expected samples that did; give another."
        )
    return {**table, **drawn(came, tick), "loss": float(np.isnan(late).mean())}


def drawn(late: NDArray[np.float64], tick: float) -> dict[str, Any]:
    """Return delay, delay_steps and delay_stay of delays [ticks] in the order in which samples were taken.

    A chain is at a value as often as 1 / (1 - stay) says, so 1 - stay_i = c / (how often i is in the log); c is such that the
    next delay is the same as often as there, as far as a probability allows.
    """
    values = np.unique(np.quantile(late, (np.arange(MANY) + 0.5) / MANY, method="nearest"))
    delay = round(float(values[0] * tick), DIGITS)
    if len(values) == 1:
        return {"delay": delay}
    part = np.abs(late[:, None] - values).argmin(1)
    often = np.bincount(part, minlength=len(values)) / len(part)
    again = float(np.mean(part[1:] == part[:-1]))
    leave = min((1 - again) / len(values), float(often.min()))
    return {
        "delay": delay,
        "delay_steps": [round(float((v - values[0]) * tick), DIGITS) for v in values],
        "delay_stay": [min(max(1 - leave / share, 0.0), MOST) for share in often.tolist()],
    }
