"""The axis that is asked about: a number of every scenario's own, for all channels (`delay`) or one of them (`delay[0]`)."""

import re
from typing import Any, NamedTuple

from pcbench.errors import UserError, short, unknown
from pcbench.limits.scale import Scale
from pcbench.plants import numbers_of, parameters_in
from pcbench.scenarios import INTERVAL, Scenario
from pcbench.study import axes
from pcbench.study.times import chain

ONE = re.compile(r"(.+)\[(\d+)\]")
TAIL_SAMPLES = 4  # in the tail of a run at least, by default
DECADE = 10.0  # about a noise: so much below and above, by default


class Axis(NamedTuple):
    """An axis of a scenario, of which one number is varied."""

    name: str  # as a study knows it
    at: int | None  # of the channels or states, the one that varies; None: all, or there are none
    others: tuple[Any, ...]  # what every channel has; of the one that varies, what it has in the scenario
    own: tuple[
        float, ...
    ]  # what the study itself says of the number that varies, its scenario's own where it says nothing

    @property
    def called(self) -> str:
        """Return what a user calls it."""
        return self.name if self.at is None else f"{self.name}[{self.at}]"

    def put(self, value: float) -> Any:
        """Return a value as the axis of a study holds it."""
        if self.at is None:
            return value
        return [value if i == self.at else other for i, other in enumerate(self.others)]

    def number(self, held: Any) -> float:
        """Return the number that varies from what an axis, or a column of the tables, holds."""
        one = self.at is None or isinstance(held, int | float)  # a number where all channels are equal
        return float(held if one else held[self.at])


def axis_of(named: str, s: Scenario, given: list[Any] | None, where: str) -> Axis:
    """Return the axis that `over` names; `given` is what the study says of it. Raise UserError where it is no single number."""
    found = ONE.fullmatch(named.strip())
    name, at = (found[1].replace("-", "_"), int(found[2])) if found else (named.strip().replace("-", "_"), None)
    known = [*axes.axes_of(s), *(f"plant.{p}" for p in parameters_in(s))]
    if name not in known:
        raise unknown("--axis", f"axis of {s.name}", name, known)
    if name in axes.LISTS:
        raise UserError(
            f"--axis: got {name}, whose values are words or lists, expected an axis of numbers such as sampling_period."
        )
    held: list[Any] = [axes.point(name, value, s, f"{where}: axes.{name}") for value in given or []] or [_own(name, s)]
    if not isinstance(held[0], tuple):
        if at is not None:
            raise UserError(
                f"--axis: got {short(named)}, where {name} is one number, expected no [{at}]; write {name}."
            )
        return Axis(name, None, (), tuple(v for v in held if v is not None))
    first = held[0]
    if at is not None and at >= len(first):
        raise UserError(
            f"--axis: got {short(named)}, expected {name}[0] to {name}[{len(first) - 1}]; write one of these."
        )
    rest = {tuple(v for i, v in enumerate(each) if at not in (None, i)) for each in held}
    if len(rest) > 1 or (at is None and any(len(set(each)) > 1 for each in held)):
        raise UserError(
            f"--axis: got {short(named)}, whose {len(first)} numbers differ in {s.name} ({', '.join(map(str, first))}), "
            f"expected one of them; write {name}[0], and give the study one value of the others."
        )
    own = tuple(each[at or 0] for each in held)
    return Axis(name, at, first, tuple(v for v in own if v != INTERVAL))


def _own(name: str, s: Scenario) -> Any:
    """What a scenario says of an axis; of process noise that it has none of, zeros."""
    if name.startswith("plant."):
        numbers, name = numbers_of(s), name.removeprefix("plant.")
        return (getattr(numbers, "own", {}) | numbers._asdict() | dict(s.truth.parameters))[name]
    value = s.value(name)
    if name == "delay_self_transition":
        return value or chain(s.sampling)[:1] or (0.0,)
    if name in axes.OUTPUTS:
        return value or (0.0,) * len(s.sampling.delay)
    if name in axes.STATES:
        return tuple(float(v) for v in value) if len(value) else (0.0,) * len(s.truth.x0)
    return value


def scale_of(axis: Axis, s: Scenario, ends: tuple[float, float] | None, tol: float | None) -> Scale:
    """Return where to search an axis; `ends` are the user's, else those of the study's values, or what a scenario suggests."""
    tick = s.dt if axis.name in axes.TIMES else 0.0
    if tol is not None and not (0 < tol < float("inf") and tol >= tick * (1 - 1e-9)):
        least = f"at least a tick, {tick:g} s" if tick else "a number above 0"
        raise UserError(f"--tol: got {tol:g}, expected {least}; leave it out for a twentieth of the value.")
    low, high = ends or (_between(axis) if len(set(axis.own)) > 1 else _usual(axis, s))
    for end in (low, high):
        axes.point(axis.name, axis.put(end), s, "--range")
    if not low < high:
        raise UserError(f"--range: got {low:g} {high:g}, expected the lower end first; write --range {high:g} {low:g}.")
    scale = Scale(low, high, tick, tol)
    return scale._replace(also=tuple(v for v in axis.own if low <= v <= high))


def _between(axis: Axis) -> tuple[float, float]:
    return min(axis.own), max(axis.own)


def _round(value: float) -> float:
    return float(f"{value:.1g}")


def _usual(axis: Axis, s: Scenario) -> tuple[float, float]:
    """The range in which a scenario's number is looked for where nobody says one."""
    own = axis.own[0] if axis.own else 0.0
    long = max(int((s.duration - s.scoring.steady_start) / TAIL_SAMPLES / s.dt + 1e-6), 2) * s.dt
    period = min(s.sampling.sampling_period)
    usual = {
        "sampling_period": (s.dt, long),
        "delay": (0.0, long),
        "actuator_delay": (0.0, long),
        "delay_jitter": (0.0, long),
        "command_jitter": (0.0, long),
        "sampling_jitter": (0.0, max((round(period / s.dt) - 1) // 2, 0) * s.dt),
        "assumed_delay_error": (0.0, max(period, s.dt)),
        "loss": (0.0, 0.9),
        "delay_self_transition": (0.0, 0.95),
        "command_loss": (0.0, 0.9),
        "outlier_probability": (0.0, 0.5),
        "student_t_dof": (2.1, 30.0),
        "dither": (0.0, 1.0),
        "mean_burst_length": (2.0, 20.0),
        "delay_gamma_mean": (0.0, long),
        "delay_gamma_shape": (0.5, 10.0),
        "timestamp_offset": (-period, period),
        "clock_skew": (0.0, 1000.0),
        "timestamp_jitter": (0.0, max((round(period / s.dt) - 1) // 2, 0) * s.dt),
        "assumed_noise_scale": (0.1, 10.0),
        "parameter_drift": (0.0, 2.0),
    }.get(axis.name)
    if usual is None and own:
        usual = (own, 2 * own) if axis.name.startswith("plant.") else (_round(own / DECADE), _round(own * DECADE))
    if usual is None or not usual[0] != usual[1]:
        raise UserError(
            f"--range: {s.name} suggests none for {axis.called}, expected the two ends of a range; write --range LOW HIGH."
        )
    rounded = tuple(float(f"{end:.12g}") for end in sorted(usual))
    return rounded[0], rounded[1]
