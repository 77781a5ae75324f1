"""Seconds to ticks: a scenario's horizon, periods, delays and jitters as whole numbers, once for each cell."""

from typing import NamedTuple

import numpy as np

from pcbench.protocols import Delay
from pcbench.scenarios import Sampling, Scenario
from pcbench.scenarios.scenario import LOST
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
    """Return the sensors of a scenario in ticks: channels of equal period and delay are one."""
    measured, groups = s.sampling, dict[tuple[float, float | str], list[int]]()
    for j, times in enumerate(zip(measured.sampling_period, measured.delay, strict=True)):
        groups.setdefault(times, []).append(j)
    return [
        Clock(
            channels=tuple(channels),
            period=whole(period, s),
            delay=None if isinstance(delay, str) else whole(delay, s),
            profile=measured.sampling_pattern
            if isinstance(measured.sampling_pattern, str)
            else tuple(whole(v, s) for v in measured.sampling_pattern),
            jitter=whole(measured.sampling_jitter, s),
            spread=whole(measured.delay_jitter, s),
            steps=steps(s),
            stay=chain(measured),
            share=shares(measured, s.dt),
            turns=tuple(sampling.LOST if v == LOST else whole(float(v), s) for v in measured.delay_sequence),
            loss=measured.loss,
            burst=measured.mean_burst_length if measured.loss else 0.0,
            stamp=stamp(s),
            early=measured.prefilled,
            swing=(measured.delay_sine[0] / s.dt, measured.delay_sine[1] * s.dt),
        )
        for (period, delay), channels in groups.items()
    ]


def stamp(s: Scenario) -> Stamp:
    """Return by how much stamps are wrong, in ticks."""
    measured = s.sampling
    return Stamp(whole(measured.timestamp_offset, s), 1e-6 * measured.clock_skew, whole(measured.timestamp_jitter, s))


def steps(s: Scenario) -> tuple[int, ...]:
    """Return by how many ticks a sample may be later, where that is one of a few values, or of a gamma distribution."""
    if s.sampling.delay_gamma_mean:
        return tuple(range(len(shares(s.sampling, s.dt))))
    return tuple(whole(v, s) for v in s.sampling.delay_values)


def shares(measured: Sampling, dt: float) -> tuple[float, ...]:
    """Return how many of the samples are later by each of the delay's steps, where these are drawn one by one."""
    if measured.delay_gamma_mean:
        return gamma(measured.delay_gamma_mean / dt, measured.delay_gamma_shape)
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
