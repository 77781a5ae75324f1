"""Seconds to ticks: the one place where a cell becomes whole numbers."""

from collections.abc import Callable
from typing import Any

import numpy as np

from pcbench.scenarios import Scenario
from pcbench.simulation.schedule.sampling import Clock


def clocks(s: Scenario) -> list[Clock]:
    """Return the sensors of a scenario in ticks: channels of equal period and delay are one."""

    def whole(seconds: float) -> int:
        return round(seconds / s.dt)

    groups: dict[Any, list[int]] = {}
    for j, times in enumerate(zip(s.sampling_period, s.delay, strict=True)):
        groups.setdefault(times, []).append(j)
    profile = s.profile if isinstance(s.profile, str) else tuple(whole(v) for v in s.profile)
    swing = (s.delay_swing[0] / s.dt, s.delay_swing[1] * s.dt)
    rest = (profile, whole(s.jitter), whole(s.delay_jitter), s.loss, s.early, swing)
    return [
        Clock(tuple(channels), whole(period), None if delay is None else whole(delay), *rest)
        for (period, delay), channels in groups.items()
    ]


def actuator_delay(s: Scenario) -> Callable[[Any], Any]:
    """Return the delay from command to plant [s] as a function of time [s]."""
    mean, (swing, pace) = s.delay[0] if s.actuator_delay is None else s.actuator_delay, s.delay_swing
    return lambda t: (mean or 0.0) + swing * np.sin(pace * t)
