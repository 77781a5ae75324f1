"""Delays of a log in a study: `delay = "from:flight"` draws them as they were distributed, "in-turn:flight" takes them in turn.

Drawn: MANY delays, each from the middle of an equal part of the log's, become `delay` and `delay_values`. They occur as often,
and as often one after the other, as in the log (`delay_self_transition`); `loss` is the share that never arrived.
Channels may differ in their least delay, in their loss, and in how delays vary, which then are lists: there is one law if the
delays of all channels vary alike, else one for each channel.
In turn: the log's instants become `sampling_pattern` (intervals) and `sampling_period` (their mean), what became of each sample
`delay_sequence`, from the first one on as far as the horizon goes. A shorter log begins again, its last sample being the first.
So the resolved study holds numbers alone, and needs no log. All in whole ticks.
Not claimed: of what is drawn, that delays depend on no more than the one before, nor that losses come one by one.
"""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError, brief_repr
from pcbench.recordings import readers
from pcbench.recordings.survey import survey
from pcbench.scenarios import SCENARIOS
from pcbench.scenarios.scenario import LOST
from pcbench.study.lti import Lti
from pcbench.toml_text import TomlTable

FROM, IN_TURN = "from:", "in-turn:"
MANY = 16  # parts
MOST = 1 - 1e-6  # probability of a chain to stay
DIGITS = 12  # of a second
UNLIKE, NOISE = 0.1, 2.0  # distributions that differ by more are of two laws: by so much, and what chance may add
TAKEN = (  # what a log says, which a table may not say too
    *("delay_values", "delay_self_transition", "delay_weights", "delay_gamma_mean", "delay_gamma_shape"),
    *("delay_sequence", "delay_jitter", "loss"),
)
INSTANTS = ("sampling_period", "sampling_pattern", "sampling_jitter")  # and what it says of instants in turn
Ticks = NDArray[np.float64]
Ints = NDArray[np.int64]


def resolve_delays(table: TomlTable, where: str, folder: Path | None, tick: float) -> TomlTable:
    """Return a study's table with the delays of the log that it names; as it is where it names none."""
    if not names_log(table):
        return table
    asked: str = table["delay"]
    turns = asked.startswith(IN_TURN)
    for key in (*TAKEN, *(INSTANTS if turns else ())):
        if table.get(key):
            raise UserError(
                f"{where}.{key}: got {brief_repr(table[key])} with the delays of a recording, expected one of them; "
                "leave it out."
            )
    name = Path(asked.removeprefix(IN_TURN if turns else FROM))
    log = readers.open_log(name if folder is None else folder / name)
    survey(log)  # refuses rows and clocks that no delay can be read from
    batches = list(log.measurements())
    columns = ("channel", "sampled", "arrived")
    channel, sampled, arrived = (np.concatenate([getattr(b, c) for b in batches]) for c in columns)
    late = np.rint((arrived - sampled) / tick)
    if np.isnan(late).all():
        raise UserError(
            f"{where}.delay: got the recording {name} without arrivals, expected at least one; use another."
        )
    if turns:
        order = np.argsort(sampled, kind="stable")
        got = f"{where}.delay: got the recording {name}"
        return {**table, **in_turn(sampled[order], late[order], tick, duration_of(table), got)}
    order = np.lexsort((sampled, channel))
    return {
        **table,
        **law_of(late[order], channel[order], tick, log.channels, f"{where}.delay: got the recording {name}"),
    }


def law_of(late: Ticks, channel: Ints, tick: float, names: tuple[str, ...], got: str) -> TomlTable:
    """Return the law of delays [ticks] in the order of sampling by channel, NaN: lost.

    Raises UserError, which begins with what was `got`, where nothing of a channel arrived.
    """
    came = ~np.isnan(late)
    loss = [float(np.isnan(late[channel == c]).mean()) for c in range(len(names))]
    each = [late[came & (channel == c)] for c in range(len(names))]
    if empty := [name for name, mine in zip(names, each, strict=True) if not len(mine)]:
        raise UserError(f"{got}, in which nothing of {empty[0]} arrived, expected at least one arrival; use another.")
    least = np.array([mine.min() for mine in each])
    apart = [kolmogorov(each[0] - least[0], mine - base) for mine, base in zip(each, least, strict=True)]
    chance = [UNLIKE + NOISE * np.sqrt(1 / len(each[0]) + 1 / len(mine)) for mine in each]
    if any(distance > limit for distance, limit in zip(apart, chance, strict=True)):
        own = [fit_delay_chain(mine, np.zeros(len(mine)), tick) for mine in each]
        law: TomlTable = {key: [fitted.get(key, []) for fitted in own] for key in max(own, key=len)}
    else:
        least = least if len(set(least)) > 1 else np.zeros(len(names))
        law = fit_delay_chain((late - least[channel])[came], channel[came], tick)
        if least.any():
            law["delay"] = [round(law["delay"] + float(base) * tick, DIGITS) for base in least]
    together = float(np.isnan(late).mean())
    few = [NOISE * np.sqrt(together * (1 - together) / (channel == c).sum()) for c in range(len(names))]
    alike = all(abs(mine - together) <= limit for mine, limit in zip(loss, few, strict=True))
    return {**law, "loss": together if alike else loss}


def kolmogorov(a: Ticks, b: Ticks) -> float:
    """Return the largest difference of two distribution functions."""
    at = np.union1d(a, b)
    below = (np.searchsorted(np.sort(each), at, side="right") / len(each) for each in (a, b))
    return float(np.abs(np.subtract(*below)).max())


def names_log(table: TomlTable) -> bool:
    """Say whether the delay of a table is that of a log."""
    asked = table.get("delay")
    return isinstance(asked, str) and asked.startswith((FROM, IN_TURN))


def duration_of(table: TomlTable) -> float:
    """Return the horizon of a table [s], as it says it or as its base has it; inf where that is a scenario of a user's own."""
    said, base = table.get("duration"), table.get("base")
    if isinstance(said, int | float) and said > 0:
        return float(said)
    if isinstance(base, str):
        return SCENARIOS[base].duration if base in SCENARIOS else math.inf
    return float(Lti.model_fields["duration"].default)


def in_turn(sampled: Ticks, late: Ticks, tick: float, horizon: float, got: str) -> TomlTable:
    """Return instants and delays as they came, of samples sorted by when they were taken [s]; late [ticks], NaN: lost.

    Raises UserError, which begins with what was `got`, where there are fewer than two instants, or samples of one tick were
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
            f"{got}, whose samples at {t:g} s have different delays, expected one delay per tick; use a recording of one "
            f"channel, or write {FROM} to draw random delays."
        )
    many = min(int((instants * tick <= horizon).sum()) + 1, len(instants) - 1)  # the last one is where it begins again
    if many < 1 or np.isnan(each[:many]).all():
        raise UserError(f"{got}, which has too few arrivals to be replayed, expected two samples or more; use another.")
    least = np.nanmin(each[:many])
    intervals = np.diff(instants[: many + 1])
    return {
        "delay": round(float(least * tick), DIGITS),
        "delay_sequence": [LOST if np.isnan(v) else round(float((v - least) * tick), DIGITS) for v in each[:many]],
        "sampling_period": round(float(max(np.rint(intervals.mean()), 1) * tick), DIGITS),
        "sampling_pattern": [round(float(v * tick), DIGITS) for v in intervals],
    }


def fit_delay_chain(late: Ticks, channel: NDArray[np.generic], tick: float) -> TomlTable:
    """Return delay, delay_values and delay_self_transition of delays [ticks], by channel, in the order of sampling.

    A chain is at a value as often as 1 / (1 - stay) says, so 1 - stay_i = c / (how often i is in the log); c is such that the
    next delay is the same as often as there, as far as a probability allows.
    """
    values = np.unique(np.quantile(late, (np.arange(MANY) + 0.5) / MANY, method="nearest"))
    delay = round(float(values[0] * tick), DIGITS)
    if len(values) == 1:
        return {"delay": delay}
    part = np.abs(late[:, None] - values).argmin(1)
    often = np.bincount(part, minlength=len(values)) / len(part)
    next_one = channel[1:] == channel[:-1]
    again = float(np.sum((part[1:] == part[:-1]) & next_one) / max(np.sum(next_one), 1))
    leave = min((1 - again) / len(values), float(often.min()))
    return {
        "delay": delay,
        "delay_values": [round(float((v - values[0]) * tick), DIGITS) for v in values],
        "delay_self_transition": [min(max(1 - leave / share, 0.0), MOST) for share in often.tolist()],
    }
