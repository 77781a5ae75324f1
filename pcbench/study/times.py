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
        ticks=whole(s.horizon, s),
        tail=whole(s.scoring.tail, s),
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
            profile=measured.profile
            if isinstance(measured.profile, str)
            else tuple(whole(v, s) for v in measured.profile),
            jitter=whole(measured.jitter, s),
            spread=whole(measured.delay_jitter, s),
            steps=steps(s),
            stay=chain(measured),
            share=shares(measured, s.dt),
            turns=tuple(sampling.LOST if v == LOST else whole(float(v), s) for v in measured.delay_turns),
            loss=measured.loss,
            burst=measured.burst if measured.loss else 0.0,
            stamp=stamp(s),
            early=measured.early,
            swing=(measured.delay_swing[0] / s.dt, measured.delay_swing[1] * s.dt),
        )
        for (period, delay), channels in groups.items()
    ]


def stamp(s: Scenario) -> Stamp:
    """Return by how much stamps are wrong, in ticks."""
    measured = s.sampling
    return Stamp(whole(measured.stamp_offset, s), 1e-6 * measured.stamp_drift, whole(measured.stamp_jitter, s))


def steps(s: Scenario) -> tuple[int, ...]:
    """Return by how many ticks a sample may be later, where that is one of a few values, or of a gamma distribution."""
    if s.sampling.delay_gamma:
        return tuple(range(len(shares(s.sampling, s.dt))))
    return tuple(whole(v, s) for v in s.sampling.delay_steps)


def shares(measured: Sampling, dt: float) -> tuple[float, ...]:
    """Return how many of the samples are later by each of the delay's steps, where these are drawn one by one."""
    if measured.delay_gamma:
        return gamma(measured.delay_gamma / dt, measured.delay_shape)
    total = sum(measured.delay_share)
    return tuple(share / total for share in measured.delay_share)


def chain(measured: Sampling) -> tuple[float, ...]:
    """Return for each of the delay's steps the probability that the next sample has the same."""
    if measured.delay_share:
        return ()
    many, stay = len(measured.delay_steps), measured.delay_stay
    return (stay * many if len(stay) == 1 else stay) or (1 / many if many else 0.0,) * many


def actuator_delay(s: Scenario) -> Delay:
    """Return the delay from command to plant [s] as a function of time [s]."""
    mean = float(s.sampling.delay[0] if s.loop.actuator_delay is None else s.loop.actuator_delay)
    swing, pace = s.sampling.delay_swing
    return lambda t: mean + swing * np.sin(pace * t)
