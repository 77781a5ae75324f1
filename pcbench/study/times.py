"""Times of a scenario in ticks, and limits of the size of a study.

Durations, periods, delays and jitters become whole ticks, once per grid point. Studies that are too large for a machine are
refused at once:

- a run has at most TICKS ticks and SAMPLES samples per channel
- at most IN_FLIGHT samples of a channel are on the network at one time, and at most `MAX_OOSM_LAG` newer ones arrive before an
  older one
- a study has at most CELLS grid points per scenario, of CELL_TICKS ticks in total
- a study has at most LABELS labels of observers and SCENARIOS scenarios
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pcbench import fields
from pcbench.errors import UserError
from pcbench.protocols import Delay
from pcbench.scenarios import Sampling, Scenario
from pcbench.scenarios.scenario import LOST, PerChannel, has_rows, per_channel
from pcbench.simulation.schedule import random_times
from pcbench.simulation.schedule.sampling import LOST as LOST_TICKS
from pcbench.simulation.schedule.sampling import Clock, Stamp, ages, any_random, gamma, intervals

SENSOR_FIELDS = (  # common to the samples of one sensor; outliers do not affect times
    *("sampling_period", "delay"),
    *(name for name in fields.names(per="sensor") if not name.startswith("outlier_")),
)


class Timing(NamedTuple):
    """The times of a grid point in ticks."""

    ticks: int  # N, number of ticks of a run
    tail: int  # first tick of the tail
    error: int  # assumed age minus true age of a sample
    clocks: list[Clock]

    @property
    def random(self) -> bool:
        """Whether each run has its own schedule."""
        return any_random(self.clocks)


def times_of(s: Scenario) -> Timing:
    """Return a scenario's times in ticks."""
    return Timing(
        ticks=to_ticks(s.duration, s),
        tail=to_ticks(s.scoring.steady_start, s),
        error=to_ticks(s.belief.assumed_delay_error, s),
        clocks=clocks(s),
    )


def to_ticks(seconds: float, s: Scenario) -> int:
    """Return a time in ticks of a scenario, rounded."""
    return round(seconds / s.dt)


def clocks(s: Scenario) -> list[Clock]:
    """Return the sensors of a scenario in ticks: channels with equal sampling, delay and loss form one sensor."""
    return list(_clocks(s.sampling, s.dt))


@lru_cache(1 << 14)  # called for every grid point of a study, with few different arguments
def _clocks(all_channels: Sampling, dt: float) -> tuple[Clock, ...]:
    q, groups = len(all_channels.delay), dict[Sampling, list[int]]()
    for j in range(q):
        single: dict[str, Any] = {name: per_channel(getattr(all_channels, name), q)[j] for name in SENSOR_FIELDS}
        single |= {name: (single[name],) for name in ("sampling_period", "delay")}
        rows = {name: getattr(all_channels, name) for name in fields.names(rows=True)}
        single |= {name: v[j] for name, v in rows.items() if has_rows(v)}
        groups.setdefault(all_channels._replace(**single), []).append(j)
    return tuple(_clock(sampling, tuple(channels), dt) for sampling, channels in groups.items())


def _clock(sampling: Sampling, channels: tuple[int, ...], dt: float) -> Clock:
    """Return one sensor with its additional delays: a list of values or a gamma distribution, independent or a chain."""

    def ticks(seconds: float) -> int:
        return round(seconds / dt)

    delay, pattern = sampling.delay[0], sampling.sampling_pattern
    steps = tuple(ticks(v) for v in sampling.delay_values)
    share = tuple(w / sum(sampling.delay_weights) for w in sampling.delay_weights)
    if sampling.delay_gamma_mean:
        share = gamma(number(sampling.delay_gamma_mean) / dt, number(sampling.delay_gamma_shape))
        steps = tuple(range(len(share)))
    start, length = number(sampling.outage_start), number(sampling.outage_duration)
    offset, jitter = (ticks(v) for v in (sampling.timestamp_offset, sampling.timestamp_jitter))
    return Clock(
        channels=channels,
        period=ticks(sampling.sampling_period[0]),
        delay=None if isinstance(delay, str) else ticks(delay),
        profile=pattern if isinstance(pattern, str) else tuple(ticks(v) for v in pattern),
        jitter=ticks(number(sampling.sampling_jitter)),
        delay_jitter=ticks(number(sampling.delay_jitter)),
        delay_values=steps,
        delay_self_transition=chain(sampling),
        delay_weights=share,
        delay_sequence=tuple(LOST_TICKS if v == LOST else ticks(float(v)) for v in sampling.delay_sequence),
        loss=number(sampling.loss),
        burst=number(sampling.mean_burst_length) if sampling.loss else 0.0,
        phase=ticks(number(sampling.sampling_phase)),
        outage=(ticks(start), ticks(start + length)) if length else (0, 0),
        stamp=Stamp(offset, 1e-6 * sampling.clock_skew, jitter),
        early=sampling.prefilled,
        delay_sine=(sampling.delay_sine[0] / dt, sampling.delay_sine[1] * dt),
    )


def sensors(s: Scenario) -> Iterator[Scenario]:
    """Yield the scenario once for each set of equally measured channels, with single values instead of lists."""
    pairs = ((name, s.value(name)) for name in fields.names(per="sensor"))
    lists = {name: value for name, value in pairs if isinstance(value, tuple)}
    rows = ((name, s.value(name)) for name in fields.names(rows=True))
    lists |= {name: value for name, value in rows if has_rows(value)}
    for values in dict.fromkeys(zip(*lists.values(), strict=True)):
        yield s.with_fields(**dict(zip(lists, values, strict=True)))
    if not lists:
        yield s


def number(value: PerChannel) -> float:
    """Return the value of one channel, as selected by `sensors`."""
    (single,) = per_channel(value, 1)
    return single


def chain(sampling: Sampling) -> tuple[float, ...]:
    """Return for each additional delay the probability that the next sample has the same."""
    if sampling.delay_weights:
        return ()
    n, stay = len(sampling.delay_values), sampling.delay_self_transition
    return (stay * n if len(stay) == 1 else stay) or (1 / n if n else 0.0,) * n


def actuator_delay(s: Scenario) -> Delay:
    """Return the delay from command to plant [s] as a function of time [s]."""
    mean = float(s.sampling.delay[0] if s.loop.actuator_delay is None else s.loop.actuator_delay)
    amplitude, omega = s.sampling.delay_sine
    return lambda t: mean + amplitude * np.sin(omega * t)


TICKS = 1_000_000
SAMPLES = 100_000
IN_FLIGHT = 10_000
MAX_OOSM_LAG = 1_000
LABELS = 1_000
SCENARIOS = 500
CELLS = 10_000
CELL_TICKS = 100_000_000  # each takes at least 50 bytes before anything runs


def ticks_of(duration: float, tick: float, where: str) -> int:
    """Return a duration [s] in ticks [s]; raise UserError if it is less than two or more than TICKS."""
    n_ticks, got = duration / tick, f"{where}: got a duration of {duration:g} s at a tick of {tick:g} s"
    if n_ticks > TICKS + 0.5:
        raise UserError(f"{got}, expected at most {TICKS:,} ticks; use a shorter duration or a longer tick.")
    if round(n_ticks) < 2:
        raise UserError(f"{got}, expected at least two ticks; use a longer duration or a shorter tick.")
    return round(n_ticks)


def require_few_samples(clocks: list[Clock], ticks: int, dt: float, where: str) -> None:
    """Raise UserError if a run has too many samples, in total, on the network or out of sequence; `dt` [s] is the tick."""
    for clock in clocks:
        interval = intervals(clock, ticks)[0]
        if ticks // interval > SAMPLES:
            raise UserError(
                f"{where}: got a sample every {interval * dt:g} s over {ticks * dt:g} s, expected at most {SAMPLES:,} samples "
                f"of a channel; write a sampling_period of at least {-(-ticks // SAMPLES) * dt:g}."
            )
        max_age = ages(clock, ticks)[1]
        if max_age // interval > IN_FLIGHT:
            raise UserError(
                f"{where}: got delays of up to {max_age * dt:g} s with samples every {interval * dt:g} s, expected at most "
                f"{IN_FLIGHT:,} samples of a channel in transit; shorten the delay or sample less often."
            )
    oosm_lag = random_times.max_oosm_lag(clocks, ticks)
    if oosm_lag > MAX_OOSM_LAG:
        raise UserError(
            f"{where}: got samples that may arrive after up to {oosm_lag:,} newer ones, expected at most {MAX_OOSM_LAG:,}; use "
            "a smaller delay_jitter, smaller differences of the delays, or a longer sampling_period."
        )


def require_few_cells(cells: int, ticks: int, where: str) -> None:
    """Raise UserError if the axes of a study make too many grid points for their number of ticks."""
    limit = min(CELLS, CELL_TICKS // ticks)
    if cells > limit:
        raise UserError(
            f"{where}: axes: got {cells:,} grid points of {ticks:,} ticks, expected at most {limit:,}; remove values, or "
            "divide the study."
        )
