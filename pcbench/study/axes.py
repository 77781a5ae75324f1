"""The axes of a study: what each may hold, in seconds and SI units, and what does not fit together.

Every mistake ends in one sentence: where, what was found, what was expected, what to write instead.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from pcbench.errors import UserError, shown, unknown
from pcbench.observers import OBSERVERS, entry_of
from pcbench.plants import nonlinear, parameters_of, positive_of
from pcbench.scenarios import Scenario
from pcbench.simulation.schedule import shared
from pcbench.simulation.schedule.shared import PROFILES, Clock
from pcbench.study import limits

SMALLEST = 1e-12
LARGEST = 1e12  # no number of a scenario is larger, in SI units
CHANNELS = ("sampling_period", "delay", "noise_std")  # one value, or one for each output channel
TIMES = ("sampling_period", "delay", "actuator_delay", "jitter", "delay_jitter", "assumed_delay_error")  # whole ticks
AXES = (*CHANNELS, "drift", "profile", "jitter", "delay_jitter", "loss", "assumed_delay_error", "actuator_delay")
INTERVAL = "interval"  # a delay of one interval, in a study


def axis(name: str, values: list[Any], base: Scenario, where: str) -> list[Any]:
    """Return an axis' values as a scenario holds them; raise UserError naming the one that cannot be."""
    parameters = [f"plant.{p}" for p in parameters_of(base.plant)]
    if name not in AXES and name not in parameters:
        raise unknown(where, f"axis of {base.name}", name, [*AXES, *parameters])
    if not values:
        raise UserError(f"{where}: got an empty list, expected at least one value; leave the axis out or fill it.")
    out = [point(name, value, base, f"{where}[{i}]") for i, value in enumerate(values)]
    if len({str(v) for v in out}) < len(out):
        raise UserError(f"{where}: got a value twice in {shown(values)}, expected each once; remove the repeated one.")
    return out


def point(name: str, value: Any, base: Scenario, where: str) -> Any:
    """Return one value of an axis as a scenario holds it."""
    if name == "profile":
        return _profile(value, base, where)
    if name not in CHANNELS:
        least = None if name in ("drift", "assumed_delay_error") or name.startswith("plant.") else 0.0
        n = number(value, where, least)
        if name in TIMES:
            _whole_ticks(name, n, base, where)
        if name.removeprefix("plant.") in positive_of(base.plant) and n <= 0:
            raise UserError(f"{where}: got {shown(value)}, expected a number greater than 0: it divides, or is a size.")
        if name == "loss" and n > 1:
            raise UserError(
                f"{where}: got {shown(value)}, expected a probability from 0 to 1; divide a percentage by 100."
            )
        return n
    channels = len(base.delay)
    each = value if isinstance(value, list) else [value] * channels
    if len(each) != channels:
        raise UserError(
            f"{where}: got {len(each)} values, expected one or {channels} (a value for each output channel)."
        )
    if name == "delay" and isinstance(value, str):
        if value != INTERVAL:
            raise UserError(f"{where}: got {shown(value)}, expected seconds or '{INTERVAL}' (one sampling interval).")
        return (None,) * channels
    numbers = [number(v, where, least=0.0) for v in each]
    if name in TIMES:
        for v in numbers:
            _whole_ticks(name, v, base, where)
    return tuple(numbers)


def number(value: Any, where: str, least: float | None) -> float:
    """Return a finite number of sensible size, not below `least`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value or abs(value) == math.inf:
        raise UserError(f"{where}: got {shown(value)}, expected a finite number; write a number in SI units.")
    if abs(value) > LARGEST:
        raise UserError(
            f"{where}: got {shown(value)}, expected a number of at most {LARGEST:g} in size; write SI units."
        )
    if 0 < abs(value) < SMALLEST:
        raise UserError(f"{where}: got {value!r}, expected 0 or a number of at least {SMALLEST:g} in size; write 0.")
    if least is not None and value < least:
        raise UserError(
            f"{where}: got {value!r}, expected a number of at least {least:g}; change its sign or leave it out."
        )
    return float(value)


def _profile(value: Any, base: Scenario, where: str) -> str | tuple[float, ...]:
    if isinstance(value, str):
        if value not in PROFILES:
            raise unknown(where, "profile (or list of intervals)", value, PROFILES)
        return value
    if not isinstance(value, list | tuple) or not value:
        raise UserError(
            f"{where}: got {shown(value)}, expected one of {', '.join(PROFILES)} or a list of intervals [s]."
        )
    out = tuple(number(v, where, least=None) for v in value)
    for v in out:
        if v <= 0:
            raise UserError(f"{where}: got an interval of {v:g} s, expected at least one tick, {base.dt:g} s.")
        _whole_ticks("sampling_period", v, base, where)
    return out


def _whole_ticks(name: str, value: float, base: Scenario, where: str) -> None:
    ticks = value / base.dt
    if abs(ticks - round(ticks)) > 1e-6:
        below, above = max(math.floor(ticks), int(name == "sampling_period")) * base.dt, math.ceil(ticks) * base.dt
        near = f"{above:.12g}" if below == above else f"{below:.12g} or {above:.12g}"
        raise UserError(
            f"{where}: got {value:.12g} s, expected a whole number of ticks of {base.dt:g} s in {base.name}; "
            f"write {near}."
        )
    if name == "sampling_period" and round(ticks) < 1:
        raise UserError(f"{where}: got {value:g} s, expected at least one tick, {base.dt:g} s in {base.name}.")
    if abs(value) > base.horizon:
        raise UserError(f"{where}: got {value:g} s, expected at most the horizon of {base.name}, {base.horizon:g} s.")


def plain(name: str, value: Any, apart: bool = False) -> Any:
    """Return a value as the tables hold it: equal channels as one unless they are to stay apart, an interval as null."""
    if name == "profile":
        return value if isinstance(value, str) else ", ".join(f"{v:g}" for v in value)
    if isinstance(value, tuple):
        return list(value) if apart or len(set(value)) > 1 else value[0]
    return value


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


def fits(s: Scenario, where: str) -> None:
    """Raise UserError where a scenario's times do not fit together."""
    ticks = round(s.horizon / s.dt)
    if s.continuous:
        _at_every_stage(s, where)
    _loop(s, where)
    for clock in clocks(s):
        least = shared.intervals(clock._replace(jitter=0), ticks + clock.jitter)[0]
        if clock.jitter and 2 * clock.jitter >= least:
            raise UserError(
                f"{where}: got a jitter of {s.jitter:g} s with intervals down to {least * s.dt:g} s, expected less than half "
                f"the shortest interval, so that samples stay in order; write at most {(least - 1) // 2 * s.dt:g}."
            )
        youngest = shared.ages(clock, ticks)[0]
        if youngest * s.dt + s.assumed_delay_error < -1e-9:
            raise UserError(
                f"{where}: got an assumed_delay_error of {s.assumed_delay_error:g} s where samples may be only "
                f"{youngest * s.dt:g} s late, expected an assumed delay of 0 or more; write at least "
                f"{-youngest * s.dt:g}."
            )
    if not s.continuous:
        limits.require_few_samples(clocks(s), ticks, s.dt, where)


def _at_every_stage(s: Scenario, where: str) -> None:
    """Raise UserError where a scenario that measures continuously is given a sampler's axis."""
    nothing = {
        "sampling_period": (s.dt,) * len(s.delay),
        "delay": (0.0,) * len(s.delay),
        "noise_std": (0.0,) * len(s.delay),
        "profile": "periodic",
        "jitter": 0.0,
        "delay_jitter": 0.0,
        "loss": 0.0,
        "assumed_delay_error": 0.0,
    }
    for name, value in nothing.items():
        if getattr(s, name) != value:
            raise UserError(
                f"{where}: got {name} = {plain(name, getattr(s, name))} in {s.name}, which measures continuously and without "
                f"noise, expected no such axis; leave it out, or take a scenario that samples, such as arm/sampled."
            )


def _loop(s: Scenario, where: str) -> None:
    """Raise UserError where the delays of a closed loop cannot be, or what stands open is asked for its actuator."""
    if not s.controller:
        if s.actuator_delay is not None:
            raise UserError(
                f"{where}: got actuator_delay = {s.actuator_delay:g} s in {s.name}, where no controller gives commands, "
                "expected a closed loop such as helicopter/constant; leave it out."
            )
        return
    if s.jitter or s.delay_jitter or s.loss or s.profile == "uniform":
        raise UserError(
            f"{where}: got random sampling in {s.name}, expected samples at times that all runs share: a closed loop is not "
            "offered with times of each run's own; leave jitter, delay_jitter, loss and the profile 'uniform' out."
        )
    if None in s.delay:
        raise UserError(
            f"{where}: got a delay of one interval in {s.name}, expected seconds: measuring began before t = 0; write a number."
        )
    if len(set(s.delay)) > 1:
        each = ", ".join(f"{d:g}" for d in s.delay if d is not None)
        raise UserError(
            f"{where}: got delays of {each} s in {s.name}, expected one for all channels; write one number."
        )
    _long_enough(s, "delay", s.delay[0] or 0.0, 0.0 if s.actuator_delay is not None else s.dt / 2, where)
    if s.actuator_delay is not None:
        _long_enough(s, "actuator_delay", s.actuator_delay, s.dt / 2, where)


def _long_enough(s: Scenario, name: str, mean: float, least: float, where: str) -> None:
    """Raise UserError where a delay of a loop, with its swing, falls below `least` [s]; one that is always 0 may."""
    t = (np.arange(round(s.horizon / s.dt) + 1) + 0.5) * s.dt
    lowest = mean + float(np.min(s.delay_swing[0] * np.sin(s.delay_swing[1] * t)))
    if lowest < least - 1e-9 and (s.delay_swing[0] or mean):
        need = math.ceil((mean - lowest + least) / s.dt - 1e-6) * s.dt
        raise UserError(
            f"{where}: got {name} = {mean:g} s in {s.name}, which falls to {max(lowest, 0):g} s or less as it varies, expected "
            f"at least half a tick on the way to the plant, and never below 0; write at least {need:g}."
            if s.delay_swing[0]
            else f"{where}: got {name} = {mean:g} s in {s.name}, expected 0 or at least half a tick; write {need:g}."
        )


def works_on(label: str, s: Scenario, where: str) -> None:
    """Raise UserError where an observer cannot work on a scenario's schedule."""
    if nonlinear(s.plant) and not entry_of(label).nonlinear:
        able = ", ".join(name for name, entry in OBSERVERS.items() if entry.nonlinear)
        raise UserError(
            f"{where}: {label} in {s.name} got a nonlinear plant, expected a linear model to be designed from; leave {label} "
            f"out, or take one of {able}."
        )
    if s.continuous and entry_of(label).observer.field is None:
        able = ", ".join(name for name, entry in OBSERVERS.items() if entry.observer.field)
        raise UserError(
            f"{where}: {label} in {s.name} got continuous measurements, expected samples: it is no vector field; leave {label} "
            f"out, take one of {able}, or a scenario that samples."
        )
    takes, found = entry_of(label).takes, clocks(s)
    follows = None in s.delay and (s.profile != "periodic" or s.jitter > 0)
    if takes == "one constant delay" and (s.delay_jitter or follows):
        varies = f"a delay jitter of {s.delay_jitter:g} s" if s.delay_jitter else "a delay of one varying interval"
        raise UserError(
            f"{where}: {label} in {s.name} got {varies}, expected one constant delay: it does not use the age of a "
            f"sample; leave {label} out, or take pccebo, pco or dkf."
        )
    if takes == "constant delays" and (s.delay_jitter or s.jitter or s.profile != "periodic"):
        times = {"a delay_jitter of": s.delay_jitter, "a jitter of": s.jitter}
        unsteady = [f"{what} {v:g} s" for what, v in times.items() if v]
        unsteady += [f"the profile {plain('profile', s.profile)}"] if s.profile != "periodic" else []
        raise UserError(
            f"{where}: {label} in {s.name} got {', '.join(unsteady)}, expected regular samples of constant ages: it works "
            f"sample by sample; leave {label} out, or take dkf."
        )
    if takes == "one clock" and len(found) > 1:
        raise UserError(
            f"{where}: {label} in {s.name} got channels with periods {s.sampling_period} and delays {s.delay} s, expected one "
            f"period and one delay for all; give equal ones, or take dkf."
        )
