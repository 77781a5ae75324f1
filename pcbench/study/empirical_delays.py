"""Delays from a recording: `delay = "from:flight"` draws them from its distribution, "in-turn:flight" replays them in order.

from:
    `N_PARTS` delays, each the middle of an equal part of the recording's, become `delay` and `delay_values`. Their frequencies,
    and the frequency of equal successive delays, are those of the recording (`delay_self_transition`). `loss` is the share that
    never arrived. Channels may differ in smallest delay, loss and variation, which are then lists: one distribution if the
    delays of all channels vary alike, else one per channel.

in-turn:
    The recording's sampling instants become `sampling_pattern` (intervals) and `sampling_period` (their mean). The delay or
    loss of each sample becomes `delay_sequence`, from the first sample to the end of the run. A shorter recording is repeated;
    its last sample is then the first.

All times are whole ticks. The resolved study contains only numbers, and does not need the recording.
Not claimed, for drawn delays: that a delay depends only on the previous one, or that losses are independent.
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
N_PARTS = 16  # number of parts
MAX_STAY = 1 - 1e-6  # largest probability of a chain to keep its value
DIGITS = 12  # decimal digits of a second
UNLIKE, NOISE = 0.1, 2.0  # largest difference of distributions treated as one, and the allowance for chance
RECORDED_KEYS = (  # keys set by a recording, which the table may not set
    *("delay_values", "delay_self_transition", "delay_weights", "delay_gamma_mean", "delay_gamma_shape"),
    *("delay_sequence", "delay_jitter", "loss"),
)
SAMPLING_KEYS = ("sampling_period", "sampling_pattern", "sampling_jitter")  # keys set by a recording replayed in order
Ticks = NDArray[np.float64]
Ints = NDArray[np.int64]


def resolve_delays(table: TomlTable, where: str, folder: Path | None, tick: float) -> TomlTable:
    """Return a study's table with the delays of a recording that it names; unchanged if it names none."""
    if not names_log(table):
        return table
    delay: str = table["delay"]
    in_order = delay.startswith(IN_TURN)
    for key in (*RECORDED_KEYS, *(SAMPLING_KEYS if in_order else ())):
        if table.get(key):
            raise UserError(
                f"{where}.{key}: got {brief_repr(table[key])} with the delays of a recording, expected one of them; "
                "leave it out."
            )
    name = Path(delay.removeprefix(IN_TURN if in_order else FROM))
    log = readers.open_log(name if folder is None else folder / name)
    survey(log)  # raises UserError for rows and clocks without usable delays
    batches = list(log.measurements())
    columns = ("channel", "sampled", "arrived")
    channel, sampling_time, arrival_time = (np.concatenate([getattr(b, c) for b in batches]) for c in columns)
    delays = np.rint((arrival_time - sampling_time) / tick)
    if np.isnan(delays).all():
        raise UserError(
            f"{where}.delay: got the recording {name} without arrivals, expected at least one; use another."
        )
    got = f"{where}.delay: got the recording {name}"
    if in_order:
        order = np.argsort(sampling_time, kind="stable")
        return {**table, **in_turn(sampling_time[order], delays[order], tick, duration_of(table), got)}
    order = np.lexsort((sampling_time, channel))
    return {**table, **distribution_of(delays[order], channel[order], tick, log.channels, got)}


def distribution_of(delays: Ticks, channel: Ints, tick: float, names: tuple[str, ...], got: str) -> TomlTable:
    """Return the distribution of delays [ticks] in sampling order by channel, NaN: lost.

    Raises UserError, which begins with `got`, if nothing of a channel arrived.
    """
    arrived = ~np.isnan(delays)
    loss = [float(np.isnan(delays[channel == c]).mean()) for c in range(len(names))]
    by_channel = [delays[arrived & (channel == c)] for c in range(len(names))]
    if empty := [name for name, d in zip(names, by_channel, strict=True) if not len(d)]:
        raise UserError(f"{got}, in which nothing of {empty[0]} arrived, expected at least one arrival; use another.")
    least = np.array([d.min() for d in by_channel])
    distances = [kolmogorov(by_channel[0] - least[0], d - base) for d, base in zip(by_channel, least, strict=True)]
    limits = [UNLIKE + NOISE * np.sqrt(1 / len(by_channel[0]) + 1 / len(d)) for d in by_channel]
    if any(distance > limit for distance, limit in zip(distances, limits, strict=True)):
        chains = [fit_delay_chain(d, np.zeros(len(d)), tick) for d in by_channel]
        distribution: TomlTable = {key: [chain.get(key, []) for chain in chains] for key in max(chains, key=len)}
    else:
        least = least if len(set(least)) > 1 else np.zeros(len(names))
        distribution = fit_delay_chain((delays - least[channel])[arrived], channel[arrived], tick)
        if least.any():
            distribution["delay"] = [round(distribution["delay"] + float(base) * tick, DIGITS) for base in least]
    mean_loss = float(np.isnan(delays).mean())
    tolerances = [NOISE * np.sqrt(mean_loss * (1 - mean_loss) / (channel == c).sum()) for c in range(len(names))]
    is_uniform = all(abs(p - mean_loss) <= limit for p, limit in zip(loss, tolerances, strict=True))
    return {**distribution, "loss": mean_loss if is_uniform else loss}


def kolmogorov(a: Ticks, b: Ticks) -> float:
    """Return the largest difference of two distribution functions."""
    points = np.union1d(a, b)
    below = (np.searchsorted(np.sort(x), points, side="right") / len(x) for x in (a, b))
    return float(np.abs(np.subtract(*below)).max())


def names_log(table: TomlTable) -> bool:
    """Return whether the delay of a table is from a recording."""
    delay = table.get("delay")
    return isinstance(delay, str) and delay.startswith((FROM, IN_TURN))


def duration_of(table: TomlTable) -> float:
    """Return the duration of a table [s], its own or that of its base; inf if the base is user-defined."""
    duration, base = table.get("duration"), table.get("base")
    if isinstance(duration, int | float) and duration > 0:
        return float(duration)
    if isinstance(base, str):
        return SCENARIOS[base].duration if base in SCENARIOS else math.inf
    return float(Lti.model_fields["duration"].default)


def in_turn(sampling_time: Ticks, delays: Ticks, tick: float, duration: float, got: str) -> TomlTable:
    """Return instants and delays in order, of samples sorted by sampling time [s]; `delays` [ticks], NaN: lost.

    Raises UserError, which begins with `got`, if there are fewer than two instants, or if samples of one tick have different
    delays, as a study has one delay for all.
    """
    ticks = np.rint((sampling_time - sampling_time[0]) / tick)
    instants, first = np.unique(ticks, return_index=True)
    by_instant = delays[first]
    differs = ~((delays == np.repeat(by_instant, np.diff(np.append(first, len(ticks))))) | np.isnan(delays))
    differs |= np.isnan(delays) != np.isnan(np.repeat(by_instant, np.diff(np.append(first, len(ticks)))))
    if differs.any():
        t = sampling_time[np.argmax(differs)]
        raise UserError(
            f"{got}, whose samples at {t:g} s have different delays, expected one delay per tick; use a recording of one "
            f"channel, or write {FROM} to draw random delays."
        )
    n = min(int((instants * tick <= duration).sum()) + 1, len(instants) - 1)  # the pattern repeats from the last one
    if n < 1 or np.isnan(by_instant[:n]).all():
        raise UserError(f"{got}, which has too few arrivals to be replayed, expected two samples or more; use another.")
    least = np.nanmin(by_instant[:n])
    intervals = np.diff(instants[: n + 1])
    return {
        "delay": round(float(least * tick), DIGITS),
        "delay_sequence": [LOST if np.isnan(v) else round(float((v - least) * tick), DIGITS) for v in by_instant[:n]],
        "sampling_period": round(float(max(np.rint(intervals.mean()), 1) * tick), DIGITS),
        "sampling_pattern": [round(float(v * tick), DIGITS) for v in intervals],
    }


def fit_delay_chain(delays: Ticks, channel: NDArray[np.generic], tick: float) -> TomlTable:
    """Return delay, delay_values and delay_self_transition of delays [ticks], by channel, in sampling order.

    The stationary probability of a value is proportional to 1 / (1 - stay), so 1 - stay_i = c / (frequency of i). c is chosen
    such that equal successive delays are as frequent as in the recording, as far as probabilities allow.
    """
    values = np.unique(np.quantile(delays, (np.arange(N_PARTS) + 0.5) / N_PARTS, method="nearest"))
    delay = round(float(values[0] * tick), DIGITS)
    if len(values) == 1:
        return {"delay": delay}
    part = np.abs(delays[:, None] - values).argmin(1)
    frequency = np.bincount(part, minlength=len(values)) / len(part)
    is_next = channel[1:] == channel[:-1]
    repeat_rate = float(np.sum((part[1:] == part[:-1]) & is_next) / max(np.sum(is_next), 1))
    c = min((1 - repeat_rate) / len(values), float(frequency.min()))
    return {
        "delay": delay,
        "delay_values": [round(float((v - values[0]) * tick), DIGITS) for v in values],
        "delay_self_transition": [min(max(1 - c / f, 0.0), MAX_STAY) for f in frequency.tolist()],
    }
