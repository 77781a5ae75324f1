"""Seconds to ticks: a scenario's horizon, periods, delays and jitters as whole numbers, once for each cell.

What one study may ask of a machine: more is refused at once, not after hours or when memory runs out.

A run has at most TICKS ticks and SAMPLES samples of a channel, of which at most IN_FLIGHT are on their way at a time and at
most OVERTAKING newer ones arrive before one. A study has at most CELLS cells in a scenario, of
CELL_TICKS ticks in all, and at most LABELS labels of observers
and SCENARIOS scenarios.
"""

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import numpy as np

from pcbench import fields
from pcbench.errors import UserError
from pcbench.protocols import Delay
from pcbench.scenarios import Sampling, Scenario
from pcbench.scenarios.scenario import LOST, OUTLIERS, PerChannel, per_channel
from pcbench.simulation.schedule import random_times, sampling
from pcbench.simulation.schedule.sampling import Clock, Stamp, any_random, gamma

OF_A_SENSOR = ("sampling_period", "delay", *(name for name in fields.names(per="sensor") if name not in OUTLIERS))


class Timing(NamedTuple):
    """The times of a cell in ticks."""

    ticks: int  # N, of the horizon
    tail: int  # where the tail begins
    error: int  # by which observers believe every sample to be older than it is
    clocks: list[Clock]

    @property
    def random(self) -> bool:
        """Whether every run has a schedule of its own."""
        return any_random(self.clocks)


def times_of(s: Scenario) -> Timing:
    """Return a scenario's times in ticks."""
    return Timing(
        ticks=whole(s.duration, s),
        tail=whole(s.scoring.steady_start, s),
        error=whole(s.belief.assumed_delay_error, s),
        clocks=clocks(s),
    )


def whole(seconds: float, s: Scenario) -> int:
    """Return a time in ticks of a scenario, the nearest."""
    return round(seconds / s.dt)


def clocks(s: Scenario) -> list[Clock]:
    """Return the sensors of a scenario in ticks: channels whose samples are taken, delayed and lost alike are one."""
    many, groups = len(s.sampling.delay), dict[Sampling, list[int]]()
    for j in range(many):
        alone: dict[str, Any] = {name: per_channel(s.value(name), many)[j] for name in OF_A_SENSOR}
        alone |= {name: (alone[name],) for name in ("sampling_period", "delay")}
        groups.setdefault(s.sampling._replace(**alone), []).append(j)
    return [
        Clock(
            channels=tuple(channels),
            period=whole(measured.sampling_period[0], s),
            delay=None if isinstance(delay := measured.delay[0], str) else whole(delay, s),
            profile=measured.sampling_pattern
            if isinstance(measured.sampling_pattern, str)
            else tuple(whole(v, s) for v in measured.sampling_pattern),
            jitter=whole(number(measured.sampling_jitter), s),
            spread=whole(number(measured.delay_jitter), s),
            steps=steps(measured, s.dt),
            stay=chain(measured),
            share=shares(measured, s.dt),
            turns=tuple(sampling.LOST if v == LOST else whole(float(v), s) for v in measured.delay_sequence),
            loss=number(measured.loss),
            burst=number(measured.mean_burst_length) if measured.loss else 0.0,
            phase=whole(number(measured.sampling_phase), s),
            outage=outage(measured, s),
            stamp=stamp(s),
            early=measured.prefilled,
            swing=(measured.delay_sine[0] / s.dt, measured.delay_sine[1] * s.dt),
        )
        for measured, channels in groups.items()
    ]


def sensors(s: Scenario) -> Iterator[Scenario]:
    """Yield the scenario once for each way in which its channels are measured, with the numbers of such a channel."""
    several = {name: s.value(name) for name in fields.names(per="sensor") if isinstance(s.value(name), tuple)}
    for each in dict.fromkeys(zip(*several.values(), strict=True)) if several else [()]:
        yield s.having(**dict(zip(several, each, strict=True)))


def number(value: PerChannel) -> float:
    """Return what one channel has, where `sensors` has chosen it."""
    (one,) = per_channel(value, 1)
    return one


def outage(measured: Sampling, s: Scenario) -> tuple[int, int]:
    """Return the first tick of a channel's outage and the first after it."""
    start, length = number(measured.outage_start), number(measured.outage_duration)
    return (whole(start, s), whole(start + length, s)) if length else (0, 0)


def stamp(s: Scenario) -> Stamp:
    """Return by how much stamps are wrong, in ticks."""
    measured = s.sampling
    return Stamp(whole(measured.timestamp_offset, s), 1e-6 * measured.clock_skew, whole(measured.timestamp_jitter, s))


def steps(measured: Sampling, dt: float) -> tuple[int, ...]:
    """Return by how many ticks a channel's sample may be later: by one of a few values, or of a gamma distribution."""
    if measured.delay_gamma_mean:
        return tuple(range(len(shares(measured, dt))))
    return tuple(round(v / dt) for v in measured.delay_values)


def shares(measured: Sampling, dt: float) -> tuple[float, ...]:
    """Return how many of the samples are later by each of the delay's steps, where these are drawn one by one."""
    if measured.delay_gamma_mean:
        return gamma(number(measured.delay_gamma_mean) / dt, number(measured.delay_gamma_shape))
    total = sum(measured.delay_weights)
    return tuple(share / total for share in measured.delay_weights)


def chain(measured: Sampling) -> tuple[float, ...]:
    """Return for each of the delay's steps the probability that the next sample has the same."""
    if measured.delay_weights:
        return ()
    many, stay = len(measured.delay_values), measured.delay_self_transition
    return (stay * many if len(stay) == 1 else stay) or (1 / many if many else 0.0,) * many


def actuator_delay(s: Scenario) -> Delay:
    """Return the delay from command to plant [s] as a function of time [s]."""
    mean = float(s.sampling.delay[0] if s.loop.actuator_delay is None else s.loop.actuator_delay)
    swing, pace = s.sampling.delay_sine
    return lambda t: mean + swing * np.sin(pace * t)


TICKS = 1_000_000
SAMPLES = 100_000
IN_FLIGHT = 10_000
OVERTAKING = 1_000
LABELS = 1_000
SCENARIOS = 500
CELLS = 10_000
CELL_TICKS = 100_000_000  # each takes at least 50 bytes before anything runs


def ticks_of(horizon: float, tick: float, where: str) -> int:
    """Return a horizon [s] in ticks [s]; raise UserError where that is less than two or more than TICKS."""
    many = horizon / tick
    if many > TICKS + 0.5:
        raise UserError(
            f"{where}: got a duration of {horizon:g} s at a tick of {tick:g} s, expected at most {TICKS:,} ticks; take a "
            "shorter horizon or a longer tick."
        )
    if round(many) < 2:
        raise UserError(
            f"{where}: got a duration of {horizon:g} s at a tick of {tick:g} s, expected at least two ticks; take a longer "
            "horizon or a shorter tick."
        )
    return round(many)


def require_few_samples(clocks: list[Clock], ticks: int, dt: float, where: str) -> None:
    """Raise UserError where samples are too many for a run, on their way at a time, or out of order; `dt` [s] is the tick."""
    for clock in clocks:
        least = sampling.intervals(clock, ticks)[0]
        if ticks // least > SAMPLES:
            raise UserError(
                f"{where}: got a sample every {least * dt:g} s over {ticks * dt:g} s, expected at most {SAMPLES:,} samples of "
                f"a channel; write a sampling_period of at least {-(-ticks // SAMPLES) * dt:g}."
            )
        longest = sampling.ages(clock, ticks)[1]
        if longest // least > IN_FLIGHT:
            raise UserError(
                f"{where}: got samples up to {longest * dt:g} s late and only {least * dt:g} s apart, expected at most "
                f"{IN_FLIGHT:,} of a channel on their way at a time; shorten the delay or sample less often."
            )
    most = random_times.overtaking(clocks, ticks)
    if most > OVERTAKING:
        raise UserError(
            f"{where}: got samples that up to {most:,} newer ones may overtake, expected at most {OVERTAKING:,}; take a "
            "smaller delay_jitter, delays that differ less, or sample less often."
        )


def require_few_labels(labels: Collection[str], where: str) -> None:
    """Raise UserError where a study names too many observers, with their options, at a time."""
    if len(labels) > LABELS:
        raise UserError(
            f"{where}: got {len(labels):,} observers and options of observers, expected at most {LABELS:,}; divide the study."
        )


def require_few_scenarios(many: int, where: str) -> None:
    """Raise UserError where a study has too many scenarios at a time."""
    if many > SCENARIOS:
        raise UserError(f"{where}: got {many:,} scenarios, expected at most {SCENARIOS:,}; divide the study.")


def require_few_cells(cells: int, ticks: int, where: str) -> None:
    """Raise UserError where the axes of a study make too many cells of so many ticks each."""
    most = min(CELLS, CELL_TICKS // ticks)
    if cells > most:
        raise UserError(
            f"{where}: axes: got {cells:,} cells of {ticks:,} ticks, expected at most {most:,}; leave values out, or divide "
            "the study."
        )
