"""Whether faults of samples go together with the rest of a cell: each has an effect, and can be drawn as asked.

Whether what a table `[scenario]` says fits the plant: lengths of lists, names of signals, a controller's options.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from pydantic import ValidationError

from pcbench.controllers import CONTROLLERS
from pcbench.controllers import entry_of as controller_of
from pcbench.errors import UserError, unknown
from pcbench.plants import PLANTS, PlantSpec, signals_of
from pcbench.scenarios import Sampling, Scenario
from pcbench.scenarios.scenario import LOST
from pcbench.scenarios.signals import PATHS
from pcbench.signal_names import names_and_units, require_different
from pcbench.simulation.schedule import sampling
from pcbench.study.axes import plain
from pcbench.study.pydantic_errors import sentence
from pcbench.study.times import clocks, number, sensors, whole

REACH = 10  # times the horizon: no sample that is later ever arrives


def fits(s: Scenario, where: str) -> None:
    """Raise UserError where a fault of samples can have no effect, or cannot be as asked."""
    for one in sensors(s):
        _noise(one, where)
        _one_by_one(one, where)
        if one.sampling.loss or not s.sampling.loss:  # a length of bursts is of the channels that lose samples
            _losses(one, where)
    _has_effect(s, "outlier_scale", "outlier_probability", where)
    _has_effect(s, "delay_gamma_shape", "delay_gamma_mean", where)
    _chain(s, where)
    _in_turn(s, where)
    _rounding(s, where)
    _stamps(s, where)


def _noise(s: Scenario, where: str) -> None:
    """Raise UserError where a fault of samples can have no effect."""
    measured = s.sampling
    scale = s.belief.assumed_noise_scale
    if scale != 1 and not any((*measured.noise_std, *s.belief.assumed_noise_std)):
        raise UserError(
            f"{where}: got assumed_noise_scale = {scale:g} in {s.name}, where no noise is believed in, expected a noise_std "
            "above 0; give one, or leave it out."
        )
    if np.isfinite(measured.student_t_dof) and not any(measured.noise_std):
        raise UserError(
            f"{where}: got student_t_dof = {measured.student_t_dof:g} in {s.name}, whose samples have no noise, "
            f"expected a noise_std "
            "above 0; give one, or leave it out."
        )
    if measured.outlier_probability and not any(measured.noise_std):
        raise UserError(
            f"{where}: got outlier_probability = {measured.outlier_probability:g} in {s.name}, whose samples have no noise to "
            "be larger, expected a noise_std above 0; give one, or leave it out."
        )


def _has_effect(s: Scenario, name: str, needs: str, where: str) -> None:
    """Raise UserError where one field is not as usual, and another that it needs is 0."""
    found = s.value(name)
    if not s.value(needs) and found != Sampling._field_defaults[name]:
        article = "an" if needs[0] in "aeiou" else "a"
        raise UserError(
            f"{where}: got {name} = {plain(name, found)} in {s.name} with {article} {needs} of 0, where it has no effect, "
            "expected both or neither; leave it out there."
        )


def _chain(s: Scenario, where: str) -> None:
    """Raise UserError where delays cannot be a Markov chain as asked."""
    steps, stay = s.sampling.delay_values, s.sampling.delay_self_transition
    if stay and not steps:
        raise UserError(
            f"{where}: got delay_self_transition in {s.name} without delay_values, where it has no effect, expected "
            f"both or neither; write "
            "delay_values = [0.0, ...], or leave it out."
        )
    if len(steps) == 1 or len(set(steps)) < len(steps):
        raise UserError(
            f"{where}: got delay_values of {', '.join(f'{v:g}' for v in steps)} s, expected two different values or more; a "
            "delay that is always so much longer is written as delay."
        )
    if len(stay) not in (0, 1, len(steps)):
        raise UserError(
            f"{where}: got {len(stay)} values of delay_self_transition for {len(steps)} delay_values, expected one, or "
            f"one for each."
        )


def _one_by_one(s: Scenario, where: str) -> None:
    """Raise UserError where delays that are drawn one by one cannot be as asked."""
    measured = s.sampling
    steps, share = measured.delay_values, measured.delay_weights
    if share and len(share) != len(steps):
        raise UserError(
            f"{where}: got {len(share)} values of delay_weights for {len(steps)} delay_values, expected one for each: a "
            f"histogram "
            "has as many bars as places."
        )
    if share and not all(each > 0 for each in share):
        raise UserError(f"{where}: got a delay_weights of 0, expected shares greater than 0; leave that step out.")
    if share and measured.delay_self_transition:
        raise UserError(
            f"{where}: got delay_weights and delay_self_transition, expected one of them: delays are drawn one by one "
            f"or are a Markov chain."
        )
    if measured.delay_gamma_mean and steps:
        raise UserError(
            f"{where}: got delay_gamma_mean = {measured.delay_gamma_mean:g} and delay_values, expected one of them; "
            f"leave one out."
        )


def require_delays_within_reach(s: Scenario, where: str) -> None:
    """Raise UserError where delays of a gamma distribution are beyond all that can arrive, before their steps are listed."""
    for one in sensors(s):
        mean, shape = number(one.sampling.delay_gamma_mean), number(one.sampling.delay_gamma_shape)
        if not mean or s.sampling.continuous:
            continue
        if not (latest := sampling.latest_of_gamma(mean, shape)) <= REACH * s.duration:
            raise UserError(
                f"{where}: got delay_gamma_mean = {mean:g} s with delay_gamma_shape = {shape:g}, by which one sample of 10,000 "
                f"is later than {latest:.3g} s, expected at most {REACH:g} times the duration of {s.duration:g} s; write a "
                "smaller mean."
            )


def _in_turn(s: Scenario, where: str) -> None:
    """Raise UserError where delays in turn stand beside what is drawn, or let nothing arrive."""
    turns = s.sampling.delay_sequence
    if turns and set(turns) == {LOST}:
        raise UserError(
            f"{where}: got delay_sequence in {s.name} of which all are '{LOST}', expected a delay among them."
        )
    drawn = ("sampling_jitter", "delay_jitter", "delay_values", "delay_gamma_mean", "loss", "timestamp_jitter")
    beside = [name for name in drawn if s.value(name)] + ["sampling_pattern 'uniform'"] * (
        s.sampling.sampling_pattern == "uniform"
    )
    if turns and beside:
        raise UserError(
            f"{where}: got {beside[0]} beside delay_sequence in {s.name}, expected one of them: delays in turn are the "
            "same in all runs, and a network that is drawn is another in each; leave one out."
        )


def _losses(s: Scenario, where: str) -> None:
    """Raise UserError where losses cannot come in bursts as asked."""
    loss, burst = number(s.sampling.loss), number(s.sampling.mean_burst_length)
    if burst and not 0 < loss < 1:
        raise UserError(
            f"{where}: got mean_burst_length = {burst:g} in {s.name} with a loss of {loss:g}, expected a loss between 0 "
            f"and 1 to come "
            "in bursts; give one, or leave mean_burst_length out."
        )
    if burst and burst < max(1, loss / (1 - loss)) * (1 - 1e-12):
        raise UserError(
            f"{where}: got mean_burst_length = {burst:g} in {s.name} with a loss of {loss:g}, expected gaps of at least "
            f"{max(1, loss / (1 - loss)):g} samples in the mean, which so many losses leave at least; write more."
        )


def _rounding(s: Scenario, where: str) -> None:
    """Raise UserError where there is dither and nothing is rounded."""
    if s.sampling.dither and not any(s.sampling.quantization_step):
        raise UserError(
            f"{where}: got dither = 1 in {s.name}, where samples are not rounded, expected a quantization_step above 0; "
            "give one, or leave it out."
        )


def _stamps(s: Scenario, where: str) -> None:
    """Raise UserError where stamps would not be in the order of the samples of a sensor, or a drift moves none of them."""
    drift, ticks = abs(s.sampling.clock_skew), whole(s.duration, s)
    if drift and round(1e-6 * drift * ticks) == 0:
        raise UserError(
            f"{where}: got a clock_skew of {s.sampling.clock_skew:g} ppm in {s.name}, which moves no stamp by half a tick "
            f"({s.dt / 2:g} s) within the horizon, so no result would change; write more than {5e5 / ticks:.3g} ppm, take a "
            "shorter tick, or leave it out."
        )
    if drift > 1e5:
        raise UserError(
            f"{where}: got a clock_skew of {drift:g} ppm, expected at most 100,000: a clock that fast is none."
        )
    for clock in clocks(s):
        least = sampling.intervals(clock, ticks)[0]
        if clock.stamp.jitter and 2 * clock.stamp.jitter >= least * (1 - 1e-6 * drift) - 1:
            raise UserError(
                f"{where}: got a timestamp_jitter of {s.sampling.timestamp_jitter:g} s with intervals down to "
                f"{least * s.dt:g} s, "
                "expected less than half the shortest interval, so that stamps stay in order; write at most "
                f"{max((least - 2) // 2, 0) * s.dt:g}."
            )


def require_stamps_before_arrivals(s: Scenario, late: int, youngest: int, where: str) -> None:
    """Raise UserError where stamps may be `late` ticks ahead of samples that arrive at a believed age of `youngest` ticks."""
    if late > youngest:
        raise UserError(
            f"{where}: got stamps up to {late * s.dt:g} s ahead in {s.name}, where samples may be only {youngest * s.dt:g} s "
            "late, expected none to arrive before its stamp; take smaller errors of stamps, a negative timestamp_offset, or a "
            "longer delay."
        )


# by field: how many numbers, and whether none is allowed as well
SIZES = {
    "x0": ("n", False),
    "process_std": ("n", True),
    "xhat0": ("n", False),
    "prior_std": ("n", False),
    "unknown0": ("s", True),
    "unknown_std": ("s", False),
    "assumed_noise_std": ("q", True),
    "assumed_process_std": ("n", True),
    "initial_box": ("n", True),
    "settle_band": ("n + s", False),
}
EACH = {"n": "state", "s": "unknown", "q": "output", "n + s": "state and unknown"}


def each(given: float | list[float], many: int) -> list[float]:
    """Return a list of numbers as it is, and one number as that of all."""
    return given if isinstance(given, list) else [float(given)] * many


def control(s: Scenario, entry: PlantSpec, where: str) -> dict[str, Any]:
    """The controller's options, checked."""
    name = s.loop.controller
    if name not in CONTROLLERS and "controller" not in s.own:
        raise unknown(f"{where}.controller", "controller (or MODULE:NAME)", name, CONTROLLERS)
    if name == "pd" and entry.inverse is None:
        able = ", ".join(each for each, plant in PLANTS.items() if plant.inverse)
        raise UserError(f"{where}.controller: got 'pd' on {s.plant}, expected a plant that it is for: {able}.")
    control, model = dict(s.loop.control), controller_of(s).options
    try:
        model.model_validate(control)
    except ValidationError as error:
        raise sentence(f"{where}.control", error, {"": model.model_fields}) from None
    if "path" in control and control["path"] not in PATHS:
        raise unknown(f"{where}.control.path", "path", control["path"], PATHS)
    return control


def require_names(text: str, valid: Iterable[str], many: int, what: str, where: str) -> None:
    """Raise UserError for a signal that is none, or where they are neither one nor one for each of `many`."""
    names, columns = [part.strip() for part in text.split(",")], 0
    for name in names:
        if name not in valid:
            raise unknown(where, "input", name, valid)
        columns += 2 if name.startswith("heater") else 1
    if columns not in (1, many):
        raise UserError(f"{where}: got {columns} signals, expected one, or one for each {what} ({many}).")


def require_fit(s: Scenario, many: dict[str, int], entry: PlantSpec, where: str) -> None:
    """Raise UserError for a list of the wrong length, and for what the scoring cannot be."""
    for key, (size, optional) in SIZES.items():
        got, want = len(s.value(key)), many[size]
        if got != want and not (optional and not got):
            raise UserError(
                f"{where}.{key}: got {got} numbers, expected {want}, one for each {EACH[size]} of {s.plant}."
            )
    bound = s.scoring.divergence_threshold
    if isinstance(bound, tuple) and len(bound) != many["n + s"]:
        raise UserError(
            f"{where}.divergence_threshold: got {len(bound)} numbers, expected one, or {many['n + s']}, one for each state and "
            "unknown."
        )
    if not 0 <= s.scoring.steady_start < s.duration:
        raise UserError(
            f"{where}.steady_start: got {s.scoring.steady_start:g} s, expected less than the duration of {s.duration:g} s."
        )
    names = [name for name, _ in signals_of(s)]
    for name in s.scoring.headline:
        if name not in names:
            raise unknown(f"{where}.headline", "signal", name, names)
    require_different(names, f"{where}.signals")


def signals(texts: list[str], many: int, where: str) -> tuple[tuple[str, str], ...]:
    """Names and units from texts such as "angle [rad]"."""
    if len(texts) != many:
        raise UserError(f"{where}: got {len(texts)} names, expected {many}.")
    return names_and_units(texts, where)
