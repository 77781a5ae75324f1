"""Whether a cell can be run: periods, delays and loops that fit the tick, the horizon and the observers."""

import math

import numpy as np

from pcbench.errors import UserError
from pcbench.observers import OBSERVERS, ObserverSpec
from pcbench.plants import drifts, nonlinear, numbers_of, states_of
from pcbench.plants import entry_of as plant_of
from pcbench.scenarios import INTERVAL, Scenario
from pcbench.scenarios.scenario import STAMPS, PerChannel, per_channel
from pcbench.simulation.schedule import sampling
from pcbench.study import validate
from pcbench.study.axes import plain
from pcbench.study.times import OF_A_SENSOR, clocks, require_few_samples, whole

# what makes delays differ from sample to sample, besides a jitter
LATENESS = ("delay_values", "delay_sequence", "delay_gamma_mean")
STAMPED = ("clock_skew", "timestamp_jitter")  # and what makes them seem to


def fits(s: Scenario, where: str) -> None:
    """Raise UserError where a scenario's times do not fit together."""
    ticks, measured = whole(s.duration, s), s.sampling
    if measured.continuous:
        _at_every_stage(s, where)
    _loop(s, where)
    if s.truth.parameter_drift and not drifts(s):
        raise UserError(
            f"{where}: got a parameter_drift of {s.truth.parameter_drift:g} in {s.name}, where nothing drifts, expected "
            f"0; leave it out."
        )
    validate.require_delays_within_reach(s, where)
    for clock in clocks(s):
        least = sampling.intervals(clock._replace(jitter=0), ticks + clock.jitter)[0]
        if clock.jitter and 2 * clock.jitter >= least:
            raise UserError(
                f"{where}: got a sampling_jitter of {clock.jitter * s.dt:g} s with intervals down to {least * s.dt:g} s, "
                f"expected less than "
                f"half the shortest interval, so that samples stay in order; write at most {(least - 1) // 2 * s.dt:g}."
            )
        youngest = sampling.ages(clock, ticks)[0]
        if late := clock.stamp.reach(ticks)[1]:
            validate.require_stamps_before_arrivals(s, late, youngest + whole(s.belief.assumed_delay_error, s), where)
        if youngest * s.dt + s.belief.assumed_delay_error < -1e-9:
            raise UserError(
                f"{where}: got an assumed_delay_error of {s.belief.assumed_delay_error:g} s where samples may be only "
                f"{youngest * s.dt:g} s late, expected an assumed delay of 0 or more; write at least "
                f"{-youngest * s.dt:g}."
            )
    validate.fits(s, where)
    if not measured.continuous:
        require_few_samples(clocks(s), ticks, s.dt, where)


def _at_every_stage(s: Scenario, where: str) -> None:
    """Raise UserError where a scenario that measures continuously is given a sampler's axis."""
    nothing = {
        "sampling_period": (s.dt,) * len(s.sampling.delay),
        "delay": (0.0,) * len(s.sampling.delay),
        "noise_std": (0.0,) * len(s.sampling.delay),
        "sampling_pattern": "periodic",
        "sampling_jitter": 0.0,
        "delay_jitter": 0.0,
        "delay_values": (),
        "delay_sequence": (),
        "delay_gamma_mean": 0.0,
        "loss": 0.0,
        "quantization_step": (),
        "timestamp_offset": 0.0,
        "clock_skew": 0.0,
        "timestamp_jitter": 0.0,
        "assumed_delay_error": 0.0,
        "outlier_probability": 0.0,
        "student_t_dof": math.inf,
        "assumed_noise_scale": 1.0,
    }
    for name, value in nothing.items():
        if s.value(name) != value and any(np.ravel(s.value(name)) if name == "quantization_step" else (True,)):
            raise UserError(
                f"{where}: got {name} = {plain(name, s.value(name))} in {s.name}, which measures continuously and without "
                f"noise, expected no such axis; leave it out, or take a scenario that samples, such as arm/sampled."
            )


def _loop(s: Scenario, where: str) -> None:
    """Raise UserError for delays that a closed loop cannot have, and for an actuator delay where the loop is open."""
    measured, actuator_delay = s.sampling, s.loop.actuator_delay
    if not s.loop.controller:
        if actuator_delay is not None:
            raise UserError(
                f"{where}: got actuator_delay = {actuator_delay:g} s in {s.name}, where no controller gives commands, "
                "expected a closed loop such as helicopter/constant; leave it out."
            )
        return
    if not measured.prefilled:  # of a loop for any plant: its sampler is any, its commands have a delay of their own
        return
    if measured.delay_sequence:
        raise UserError(
            f"{where}: got delay_sequence in {s.name}, whose measuring began before t = 0, expected one delay of "
            f"samples; leave "
            "them out, or close the loop of another scenario (guide: loops)."
        )
    if any(clock.random for clock in clocks(s)):
        raise UserError(
            f"{where}: got random sampling in {s.name}, expected samples at times that all runs share: a closed loop is not "
            "offered with times of each run's own; leave sampling_jitter, delay_jitter, delay_values, delay_gamma_mean, "
            "timestamp_jitter, loss and the sampling_pattern 'uniform' out."
        )
    if INTERVAL in measured.delay:
        raise UserError(
            f"{where}: got a delay of one interval in {s.name}, expected seconds: measuring began before t = 0; write a number."
        )
    if len(set(measured.delay)) > 1:
        each = ", ".join(f"{d:g}" for d in measured.delay if not isinstance(d, str))
        raise UserError(
            f"{where}: got delays of {each} s in {s.name}, expected one for all channels; write one number."
        )
    _long_enough(s, "delay", float(measured.delay[0]), 0.0 if actuator_delay is not None else s.dt / 2, where)
    if actuator_delay is not None:
        _long_enough(s, "actuator_delay", actuator_delay, s.dt / 2, where)


def _long_enough(s: Scenario, name: str, mean: float, least: float, where: str) -> None:
    """Raise UserError where a delay of a loop, with its swing, falls below `least` [s]; one that is always 0 is allowed."""
    (swing, pace), t = s.sampling.delay_sine, (np.arange(whole(s.duration, s) + 1) + 0.5) * s.dt
    lowest = mean + float(np.min(swing * np.sin(pace * t)))
    if lowest < least - 1e-9 and (swing or mean):
        need = math.ceil((mean - lowest + least) / s.dt - 1e-6) * s.dt
        raise UserError(
            f"{where}: got {name} = {mean:g} s in {s.name}, which falls to {max(lowest, 0):g} s or less as it varies, expected "
            f"at least half a tick on the way to the plant, and never below 0; write at least {need:g}."
            if swing
            else f"{where}: got {name} = {mean:g} s in {s.name}, expected 0 or at least half a tick; write {need:g}."
        )


def _at_rest(label: str, s: Scenario, where: str) -> bool:
    """Whether a plant has a linear model at its operating point; raise UserError where that is no equilibrium."""
    residual = plant_of(s).residual
    if residual is None:
        return False
    moves = residual(numbers_of(s))
    if moves.any():
        i = int(np.argmax(np.abs(moves)))
        raise UserError(
            f"{where}: {label} in {s.name} got an operating point that is no equilibrium ({states_of(s)[i][0]} changes by "
            f"itself, by {moves[i]:.3g}), expected one, where the plant has a linear model; move the point, leave {label} out, "
            "or take ekf."
        )
    return True


def _each(value: PerChannel) -> str:
    return ", ".join(f"{v:g}" for v in per_channel(value, 1))


def works_on(label: str, entry: ObserverSpec, s: Scenario, where: str) -> None:
    """Raise UserError where an observer cannot work on a scenario's schedule."""
    if nonlinear(s) and not entry.nonlinear and not _at_rest(label, s, where):
        able = ", ".join(name for name, each in OBSERVERS.items() if each.nonlinear)
        raise UserError(
            f"{where}: {label} in {s.name} got a nonlinear plant, expected a linear model to be designed from; leave {label} "
            f"out, or take one of {able}."
        )
    if s.loop.controller and not entry.loops:
        raise UserError(
            f"{where}: {label} in {s.name} got a closed loop, expected an input that is known beforehand: it looks back "
            f"further than a loop keeps its inputs; leave {label} out, or take ekf."
        )
    if s.sampling.continuous and entry.observer.field is None:
        able = ", ".join(name for name, each in OBSERVERS.items() if each.observer.field)
        raise UserError(
            f"{where}: {label} in {s.name} got continuous measurements, expected samples: it is no vector field; leave {label} "
            f"out, take one of {able}, or a scenario that samples."
        )
    takes, found, measured = entry.takes, clocks(s), s.sampling
    follows = INTERVAL in measured.delay and (measured.sampling_pattern != "periodic" or bool(measured.sampling_jitter))
    drawn = [name for name in (*LATENESS, *STAMPED) if s.value(name)]
    if takes == "one constant delay" and (measured.delay_jitter or drawn or follows):
        spread = measured.delay_jitter
        varies = f"a delay_jitter of {_each(spread)} s" if spread else "a delay of one varying interval"
        varies = ", ".join(drawn) if drawn and not spread else varies
        raise UserError(
            f"{where}: {label} in {s.name} got {varies}, expected one constant delay: it does not use the age of a "
            f"sample; leave {label} out, or take pccebo, pco or kf."
        )
    random = measured.delay_jitter or drawn or measured.sampling_jitter
    if takes == "constant delays" and (random or measured.sampling_pattern != "periodic"):
        times = {"a delay_jitter of": measured.delay_jitter, "a sampling_jitter of": measured.sampling_jitter}
        unsteady = [f"{what} {_each(v)} s" for what, v in times.items() if v]
        unsteady += drawn
        unsteady += (
            [f"the sampling_pattern {plain('sampling_pattern', measured.sampling_pattern)}"]
            if measured.sampling_pattern != "periodic"
            else []
        )
        raise UserError(
            f"{where}: {label} in {s.name} got {', '.join(unsteady)}, expected regular samples of constant ages: it works "
            f"sample by sample; leave {label} out, or take kf."
        )
    if entry.observer.on_sample and any(s.value(name) for name in STAMPS):
        wrong = ", ".join(name for name in STAMPS if s.value(name))
        raise UserError(
            f"{where}: {label} in {s.name} got {wrong}, expected stamps that are right: it is told of a sample when that is "
            f"taken, whatever its stamp says; leave {label} out, or take kf."
        )
    if takes == "one clock" and len(found) > 1:
        each = {name: s.value(name) for name in OF_A_SENSOR}
        several = "; ".join(f"{k} = {plain(k, v)}" for k, v in each.items() if isinstance(v, tuple) and len(set(v)) > 1)
        raise UserError(
            f"{where}: {label} in {s.name} got channels that differ ({several}), expected one period, one delay and one "
            "network for all; give equal ones, or take kf."
        )
