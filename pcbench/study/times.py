"""Seconds to ticks: a scenario's horizon, periods, delays and jitters as whole numbers, once for each cell."""

from typing import NamedTuple

import numpy as np

from pcbench.protocols import Delay
from pcbench.scenarios import Sampling, Scenario
from pcbench.simulation.schedule.sampling import Clock, any_random


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
            steps=tuple(whole(v, s) for v in measured.delay_steps),
            stay=chain(measured),
            loss=measured.loss,
            early=measured.early,
            swing=(measured.delay_swing[0] / s.dt, measured.delay_swing[1] * s.dt),
        )
        for (period, delay), channels in groups.items()
    ]


def chain(measured: Sampling) -> tuple[float, ...]:
    """Return for each of the delay's steps the probability that the next sample has the same."""
    many, stay = len(measured.delay_steps), measured.delay_stay
    return (stay * many if len(stay) == 1 else stay) or (1 / many if many else 0.0,) * many


def actuator_delay(s: Scenario) -> Delay:
    """Return the delay from command to plant [s] as a function of time [s]."""
    mean = float(s.sampling.delay[0] if s.loop.actuator_delay is None else s.loop.actuator_delay)
    swing, pace = s.sampling.delay_swing
    return lambda t: mean + swing * np.sin(pace * t)
