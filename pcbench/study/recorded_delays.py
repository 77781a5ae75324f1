"""Delays of a log in a study: `delay = "from:flight"` draws them as they were distributed, "in-turn:flight" takes them in turn.

Drawn: MANY delays, each from the middle of an equal part of the log's, become `delay` and `delay_steps`. They occur as often,
and as often one after the other, as in the log (`delay_stay`); `loss` is the share that never arrived.
In turn: the log's instants become `profile` (intervals) and `sampling_period` (their mean), what became of each sample
`delay_turns`, from the first one on as far as the horizon goes. A shorter log begins again, its last sample being the first.
So the resolved study holds numbers alone, and needs no log. All in whole ticks.
Not claimed: of what is drawn, that delays depend on no more than the one before, nor that losses come one by one.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError, shown
from pcbench.logs import reading
from pcbench.scenarios import SCENARIOS
from pcbench.scenarios.scenario import LOST

FROM, IN_TURN = "from:", "in-turn:"
MANY = 16  # parts
MOST = 1 - 1e-6  # probability of a chain to stay
DIGITS = 12  # of a second
DRAWN = ("delay_steps", "delay_stay", "delay_share", "delay_gamma")
TAKEN = (*DRAWN, "delay_turns", "delay_jitter", "loss")  # what a log says, which a table may not say too
INSTANTS = ("sampling_period", "profile", "jitter")  # and what it says of instants in turn
USUAL = 10.0  # s, the horizon of a plant's table that says none
Ticks = NDArray[np.float64]


def resolved(table: dict[str, Any], where: str, folder: Path | None, tick: float) -> dict[str, Any]:
    """Return a study's table with the delays of the log that it names; as it is where it names none."""
    asked = table.get("delay")
    turns = isinstance(asked, str) and asked.startswith(IN_TURN)
    if not (isinstance(asked, str) and (turns or asked.startswith(FROM))):
        return table
    for key in (*TAKEN, *(INSTANTS if turns else ())):
        if table.get(key):
            raise UserError(
                f"{where}.{key}: got {shown(table[key])} beside the delays of a log, expected one; leave it out."
            )
    name = Path(asked.removeprefix(IN_TURN if turns else FROM))
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
    if turns:
        return {**table, **in_turn(sampled[order], late, tick, horizon_of(table), f"{where}.delay: got the log {name}")}
    return {**table, **drawn(came, tick), "loss": float(np.isnan(late).mean())}


def horizon_of(table: dict[str, Any]) -> float:
    """Return the horizon of a table [s], as it says it or as that which it is based on has it."""
    base = SCENARIOS.get(table["base"]) if isinstance(table.get("base"), str) else None
    said = table.get("horizon")
    return float(said) if isinstance(said, int | float) and said > 0 else base.horizon if base else USUAL


def in_turn(sampled: Ticks, late: Ticks, tick: float, horizon: float, got: str) -> dict[str, Any]:
    """Return instants and delays as they came, of samples sorted by when they were taken [s]; late [ticks], NaN: lost.

    Raises UserError, which begins with what was `got`, where there are fewer than two instants, or channels of one instant were
    not late alike: a study has one delay for all.
    """
    taken = np.rint((sampled - sampled[0]) / tick)
    instants, first = np.unique(taken, return_index=True)
    each = late[first]
    unlike = ~((late == np.repeat(each, np.diff(np.append(first, len(taken))))) | np.isnan(late))
    unlike |= np.isnan(late) != np.isnan(np.repeat(each, np.diff(np.append(first, len(taken)))))
    if unlike.any():
        t = sampled[np.argmax(unlike)]
        raise UserError(
            f"{got}, whose channels were not late alike at {t:g} s, expected one delay for all of an instant; give a log of "
            f"one channel, or write {FROM} to draw them."
        )
    many = min(int((instants * tick <= horizon).sum()) + 1, len(instants) - 1)  # the last one is where it begins again
    if many < 1 or np.isnan(each[:many]).all():
        raise UserError(
            f"{got}, of which nothing that arrived can be replayed, expected two samples or more; give another."
        )
    least = np.nanmin(each[:many])
    intervals = np.diff(instants[: many + 1])
    return {
        "delay": round(float(least * tick), DIGITS),
        "delay_turns": [LOST if np.isnan(v) else round(float((v - least) * tick), DIGITS) for v in each[:many]],
        "sampling_period": round(float(max(np.rint(intervals.mean()), 1) * tick), DIGITS),
        "profile": [round(float(v * tick), DIGITS) for v in intervals],
    }


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
