"""Seconds to ticks: a scenario's horizon, periods, delays and jitters as whole numbers, once for each cell."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from pcbench import fields
from pcbench.protocols import Delay
from pcbench.scenarios import Sampling, Scenario
from pcbench.scenarios.scenario import LOST, OUTLIERS, PerChannel, per_channel
from pcbench.simulation.schedule import sampling
from pcbench.simulation.schedule.sampling import Clock, Stamp, any_random, gamma


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
    names, many = [name for name in fields.names(per="sensor") if name not in OUTLIERS], len(s.sampling.delay)
    groups = dict[Sampling, list[int]]()
    for j in range(many):
        alone: dict[str, Any] = {name: per_channel(s.value(name), many)[j] for name in names}
        period, delay = s.sampling.sampling_period[j], s.sampling.delay[j]
        one = s.sampling._replace(sampling_period=(period,), delay=(delay,), **alone)
        groups.setdefault(one, []).append(j)
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
