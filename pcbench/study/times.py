"""Seconds to ticks: the one place where a scenario's times become whole numbers."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from pcbench.scenarios import Scenario
from pcbench.simulation.schedule.sampling import Clock, any_random


class Times(NamedTuple):
    """The times of a cell in ticks."""

    ticks: int  # N, of the horizon
    tail: int  # where the tail begins
    error: int  # by which observers believe every sample to be older than it is
    clocks: list[Clock]

    @property
    def random(self) -> bool:
        """Whether every run has a schedule of its own."""
        return any_random(self.clocks)


def times_of(s: Scenario) -> Times:
    """Return a scenario's times in ticks."""
    return Times(whole(s.horizon, s), whole(s.tail, s), whole(s.assumed_delay_error, s), clocks(s))


def whole(seconds: float, s: Scenario) -> int:
    """Return a time in ticks of a scenario, the nearest."""
    return round(seconds / s.dt)


def clocks(s: Scenario) -> list[Clock]:
    """Return the sensors of a scenario in ticks: channels of equal period and delay are one."""
    groups: dict[Any, list[int]] = {}
    for j, times in enumerate(zip(s.sampling_period, s.delay, strict=True)):
        groups.setdefault(times, []).append(j)
    profile = s.profile if isinstance(s.profile, str) else tuple(whole(v, s) for v in s.profile)
    swing = (s.delay_swing[0] / s.dt, s.delay_swing[1] * s.dt)
    rest = (profile, whole(s.jitter, s), whole(s.delay_jitter, s), s.loss, s.early, swing)
    return [
        Clock(tuple(channels), whole(period, s), None if delay is None else whole(delay, s), *rest)
        for (period, delay), channels in groups.items()
    ]


def actuator_delay(s: Scenario) -> Callable[[Any], Any]:
    """Return the delay from command to plant [s] as a function of time [s]."""
    mean, (swing, pace) = s.delay[0] if s.actuator_delay is None else s.actuator_delay, s.delay_swing
    return lambda t: (mean or 0.0) + swing * np.sin(pace * t)
