"""Search of a limit along an axis: choose values and numbers of seeds until the limit is precise enough. No jax.

For each observer, the search narrows the interval between the largest value that suffices and the smallest above it that
significantly exceeds the threshold. Seeds are added at these two as long as their intervals contain the threshold, up to a
budget. Then the interval is halved, down to the requested precision. Below the largest sufficient value only the initial values
and those that other observers need are tested, so a failure there may be missed.

- `Scale`: the range of an axis, its initial values, and the middle of two values. Times are whole ticks. The middle is the
  geometric mean if values have one sign and are far apart, else the arithmetic mean, rounded to few digits.
- `Axis`: a number of a scenario, for all channels (`delay`) or one of them (`delay[0]`).
- `Question`: one scenario, one axis, one metric of one signal, one threshold; checked before anything runs.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from math import ceil, isfinite, sqrt
from typing import Any, NamedTuple

from pcbench.dataset.adaptive_seeds import GROWTH, METRICS, seeds_for
from pcbench.dataset.columns import AXIS_UNITS, unit_of
from pcbench.errors import UserError, short, unknown
from pcbench.fields import FIELDS
from pcbench.plants import numbers_of, parameters_in, settles_alone, signals_of
from pcbench.scenarios import INTERVAL, Scenario
from pcbench.statistics import OF_RUN
from pcbench.statistics.limit_verdicts import UNDECIDED, Point, answer
from pcbench.statistics.metric_matrix import SIGNED
from pcbench.study import Study, axes, scenarios_of
from pcbench.study.times import chain

FAR = 2.0  # ratio from which the middle of two values is geometric
PRECISION = 0.05  # default precision relative to the value
FLOOR = 0.01  # finest precision relative to the range, if the range begins at 0 or below
DIGITS = 15


class Scale(NamedTuple):
    """The range of an axis."""

    low: float
    high: float
    tick: float = 0.0  # s; 0: not a time
    tol: float | None = None  # requested precision; None: PRECISION of the value
    also: tuple[float, ...] = ()  # further initial values

    def start(self) -> list[float]:
        """Return the initial values: the ends, three between them, and `also`."""
        middle = self.between(self.low, self.high)
        values = [self.low, middle, self.high, *self.also]
        if middle is not None:
            values += [self.between(self.low, middle), self.between(middle, self.high)]
        return sorted({v for v in values if v is not None})

    def is_near(self, a: float, b: float) -> bool:
        """Return whether two values, a < b, are within the requested precision."""
        floor = self.tick or (FLOOR * (self.high - self.low) if self.low <= 0 else 0.0)
        tol = max(PRECISION * max(abs(a), abs(b)), floor) if self.tol is None else self.tol
        return b - a <= tol * (1 + 1e-9) or self.between(a, b) is None

    def between(self, a: float, b: float) -> float | None:
        """Return a value about halfway between a and b, a < b, with few digits; None if there is none."""
        middle = _middle(a, b)
        first, last = _middle(a, middle), _middle(middle, b)
        for digits in range(1, DIGITS + 1):
            value = self.at(float(f"{middle:.{digits}g}"))
            if first <= value <= last and a < value < b:
                return value
        value = self.at(middle)
        return value if a < value < b and self.at(a) < value < self.at(b) else None

    def at(self, value: float) -> float:
        """Return the nearest valid value of the axis."""
        return float(f"{round(value / self.tick) * self.tick:.12g}") if self.tick else value


def _middle(a: float, b: float) -> float:
    return sqrt(a * b) if a > 0 and b > FAR * a else (a + b) / 2


MIN_GROWTH = 1.1  # smallest factor on the number of seeds per round
# (values, seeds by value) -> results by observer
Look = Callable[[list[float], Mapping[float, int]], dict[str, list[Point]]]


def search(look: Look, scale: Scale, limit: float, most: int) -> dict[str, list[Point]]:
    """Return all results by observer, in order; a value gets at most `most` seeds."""
    values, seeds = scale.start(), dict[float, int]()
    while True:
        results = look(values, seeds)
        new, new_seeds = set(values), dict(seeds)
        for points in results.values():
            requests = seeds_to_add(points, scale, limit, most)
            for value, count in requests.items():
                new_seeds[value] = max(new_seeds.get(value, 0), count)
            new |= set() if requests else set(values_to_add(points, scale))
        if new_seeds == seeds and new == set(values):
            return results
        values, seeds = sorted(new), new_seeds


def brackets(points: list[Point], scale: Scale) -> list[tuple[Point, Point]]:
    """Return the neighbouring values that enclose an observer's limit; empty if it is precise enough."""
    a = answer(points)
    if a.largest and a.exceeds and scale.is_near(a.largest.value, a.exceeds.value):
        return []
    return [(p, q) for p, q in pairwise(points) if p is a.largest or q is a.exceeds]


def values_to_add(points: list[Point], scale: Scale) -> list[float]:
    """Return the values that would make an observer's limit more precise."""
    wide = [(p.value, q.value) for p, q in brackets(points, scale) if not scale.is_near(p.value, q.value)]
    return [middle for p, q in wide if (middle := scale.between(p, q)) is not None]


def seeds_to_add(points: list[Point], scale: Scale, limit: float, most: int) -> dict[float, int]:
    """Return the number of seeds by value, where more seeds may decide an observer's verdict."""
    neighbours = [p for pair in brackets(points, scale) for p in pair]
    if answer(points).largest is None:
        neighbours.append(points[0])
    requests = {p.value: min(_seeds_needed(p, limit), most) for p in neighbours if p.verdict == UNDECIDED}
    runs = {p.value: p.runs for p in neighbours}
    return {value: count for value, count in requests.items() if count > runs[value]}


def _seeds_needed(p: Point, limit: float) -> int:
    """Return the seeds with which the end of a point's interval is expected to reach the threshold."""
    side, gap = (p.high - p.mean, limit - p.mean) if p.mean < limit else (p.mean - p.low, p.mean - limit)
    if not isfinite(side):  # only one run
        return GROWTH * p.runs
    if side == 0:  # the runs do not vary, and equal the threshold
        return p.runs
    return max(seeds_for(p.runs, side, max(gap, side / GROWTH)), ceil(MIN_GROWTH * p.runs))


CHANNEL = re.compile(r"(.+)\[(\d+)\]")
TAIL_SAMPLES = 4  # fewest samples in the tail of a run, by default
DECADE = 10.0  # default range of a noise: divided and multiplied by this


class Axis(NamedTuple):
    """An axis of a scenario, of which one number varies."""

    name: str  # name in a study
    position: int | None  # index of the channel or state that varies; None: all, or a single number
    channel_values: tuple[float | str, ...]  # values of all channels; for the one that varies, that of the scenario
    values: tuple[float, ...]  # values of the study for the number that varies; if it has none, that of the scenario

    @property
    def label(self) -> str:
        """Return the axis' name for the user, such as `delay[0]`."""
        return self.name if self.position is None else f"{self.name}[{self.position}]"

    def to_study(self, value: float) -> float | list[float | str]:
        """Return a value in the form of a study's axis."""
        if self.position is None:
            return value
        return [value if i == self.position else v for i, v in enumerate(self.channel_values)]

    def number(self, value: Any) -> float:
        """Return the number that varies from a value of an axis, or of a column of the tables."""
        one = self.position is None or isinstance(value, int | float)  # one number if all channels are equal
        return float(value if one else value[self.position])


def axis_of(text: str, s: Scenario, study_values: list[object] | None, where: str) -> Axis:
    """Return the axis called `text`; `study_values` are the study's values. Raise UserError if it is not a single number."""
    match = CHANNEL.fullmatch(text.strip())
    name, index = (match[1].replace("-", "_"), int(match[2])) if match else (text.strip().replace("-", "_"), None)
    names = [*axes.axes_of(s), *(f"plant.{p}" for p in parameters_in(s))]
    if name not in names:
        raise unknown("--axis", f"axis of {s.name}", name, names)
    if name in axes.LISTS:
        raise UserError(
            f"--axis: got {name}, whose values are words or lists, expected an axis of numbers such as sampling_period."
        )
    points: list[Any] = [axes.axis_value(name, value, s, f"{where}: axes.{name}") for value in study_values or []]
    points = points or [_scenario_value(name, s)]
    if not isinstance(points[0], tuple):
        if index is not None:
            raise UserError(
                f"--axis: got {short(text)}, where {name} is one number, expected no [{index}]; write {name}."
            )
        return Axis(name, None, (), tuple(v for v in points if v is not None))
    first = points[0]
    if index is not None and index >= len(first):
        raise UserError(
            f"--axis: got {short(text)}, expected {name}[0] to {name}[{len(first) - 1}]; write one of these."
        )
    other_values = {tuple(v for i, v in enumerate(point) if index not in (None, i)) for point in points}
    if len(other_values) > 1 or (index is None and any(len(set(point)) > 1 for point in points)):
        raise UserError(
            f"--axis: got {short(text)}, whose {len(first)} numbers differ in {s.name} ({', '.join(map(str, first))}), "
            f"expected one of them; write {name}[0], and give the study one value of the others."
        )
    values = tuple(point[index or 0] for point in points)
    return Axis(name, index, first, tuple(v for v in values if v != INTERVAL))


def _scenario_value(name: str, s: Scenario) -> axes.Value | None:
    """Return a scenario's value of an axis; zeros for process noise that it does not have."""
    if name.startswith("plant."):
        numbers, name = numbers_of(s), name.removeprefix("plant.")
        return (getattr(numbers, "parameters", {}) | numbers._asdict() | dict(s.truth.parameters))[name]
    value = s.value(name)
    if name == "delay_self_transition":
        return value or chain(s.sampling)[:1] or (0.0,)
    if name in axes.OUTPUTS:
        return value or (0.0,) * len(s.sampling.delay)
    if name in axes.STATES:
        return tuple(float(v) for v in value) if len(value) else (0.0,) * len(s.truth.x0)
    return value


def scale_of(axis: Axis, s: Scenario, ends: tuple[float, float] | None, tol: float | None) -> Scale:
    """Return the range of an axis: `ends` of the user, else those of the study's values, or a default of the scenario."""
    tick = s.dt if axis.name in axes.TIMES else 0.0
    if tol is not None and not (0 < tol < float("inf") and tol >= tick * (1 - 1e-9)):
        least = f"at least a tick, {tick:g} s" if tick else "a number above 0"
        raise UserError(f"--tol: got {tol:g}, expected {least}; leave it out for a twentieth of the value.")
    low, high = ends or ((min(axis.values), max(axis.values)) if len(set(axis.values)) > 1 else _default_range(axis, s))
    for end in (low, high):
        axes.axis_value(axis.name, axis.to_study(end), s, "--range")
    if not low < high:
        raise UserError(f"--range: got {low:g} {high:g}, expected the lower end first; write --range {high:g} {low:g}.")
    scale = Scale(low, high, tick, tol)
    return scale._replace(also=tuple(v for v in axis.values if low <= v <= high))


def _default_range(axis: Axis, s: Scenario) -> tuple[float, float]:
    """Return the default range of a scenario's number."""
    value = axis.values[0] if axis.values else 0.0
    longest = max(int((s.duration - s.scoring.steady_start) / TAIL_SAMPLES / s.dt + 1e-6), 2) * s.dt
    period = min(s.sampling.sampling_period)
    half_period = max((round(period / s.dt) - 1) // 2, 0) * s.dt
    ends = {"tick": s.dt, "tail": longest, "half": half_period, "period": period, "-period": -period}
    search_range = next((f.search for f in FIELDS if f.name == axis.name), None)
    usual = search_range and tuple(ends[end] if isinstance(end, str) else end for end in search_range)
    if usual is None and value:
        decades = float(f"{value / DECADE:.1g}"), float(f"{value * DECADE:.1g}")
        usual = (value, 2 * value) if axis.name.startswith("plant.") else decades
    if usual is None or not usual[0] != usual[1]:
        raise UserError(
            f"--range: {s.name} suggests none for {axis.label}, expected the two ends of a range; write --range LOW HIGH."
        )
    low, high = (float(f"{end:.12g}") for end in sorted(usual))
    return low, high


NOT_SMALLER = ("rms_efficiency", "interval_coverage", *SIGNED)
SMALLER_IS_BETTER = tuple(m for m in METRICS if m not in NOT_SMALLER)
UNITLESS = ("divergence_rate", "unsettled_rate")
EXCITATIONS = ("parameter_drift", "process_std")


class Question(NamedTuple):
    """The question of a limit search."""

    study: Study
    scenario: Scenario
    axis: Axis
    metric: str
    signal: str
    threshold: float

    @property
    def unit(self) -> str:
        """Return the metric's unit."""
        return "1" if self.metric in UNITLESS else unit_of(self.metric, dict(signals_of(self.scenario))[self.signal])

    def with_values(self, values: list[float]) -> Study:
        """Return the study with these values of the axis."""
        changes = self.study.axes | {self.axis.name: list(map(self.axis.to_study, values))}
        return self.study.model_copy(update={"axes": changes})

    @property
    def axis_unit(self) -> str:
        """Return the axis' unit; empty if unknown."""
        return AXIS_UNITS.get(self.axis.name, "").replace("1", "")


def question(study: Study, where: str, axis_name: str, metric: str, signal: str | None, threshold: float) -> Question:
    """Return the question; raise UserError for one that cannot be answered."""
    if metric not in SMALLER_IS_BETTER:
        if metric in NOT_SMALLER:
            raise UserError(
                f"--metric: got {metric}, whose smaller values are not better; use an error such as steady_pooled_rmse."
            )
        raise unknown("--metric", "metric to be kept below a limit", metric, SMALLER_IS_BETTER)
    if not (isfinite(threshold) and threshold > 0):
        raise UserError(
            f"--threshold: got {threshold:g}, expected a number above 0, in the unit of the metric; write another."
        )
    if len(study.scenarios) > 1:
        raise UserError(
            f"{where}: got {len(study.scenarios)} scenarios, expected one here; name one of {', '.join(study.scenarios)}."
        )
    s = scenarios_of(study)[study.scenarios[0]]
    axis = axis_of(axis_name, s, study.axes.get(axis_name.partition("[")[0].strip().replace("-", "_")), where)
    if axis.name == "processor_speed":
        raise UserError(
            f"{where}: got the axis processor_speed, whose larger values are better; "
            "run a study with several speeds as axes.processor_speed."
        )
    if axis.name in ("dither", "try_once_discard"):
        raise UserError(
            f"{where}: got the axis {axis.name}, which is 0 or 1, expected one with a range; run a study with both as "
            f"axes.{axis.name}=[0,1]."
        )
    for name, values in study.axes.items():
        if name != axis.name and len(values) > 1:
            raise UserError(
                f"{where}: axes.{name}: got {len(values)} values, expected one while {axis.label} is searched; add --set "
                f"axes.{name}=VALUE."
            )
    names = [name for name, _ in signals_of(s)]
    if signal is not None and signal not in names:
        raise unknown("--signal", f"signal of {s.name}", signal, names)
    signal_name = signal or (names[0] if metric in OF_RUN else (*s.scoring.headline, *names)[0])
    return Question(study, s, axis, metric, signal_name, threshold)


def notes(q: Question) -> list[str]:
    """Return notes on the interpretation of an answer."""
    note = (
        "A value suffices if the whole 95 % interval is below the limit and no run diverged. It is undecided if the interval "
        "contains the limit."
    )
    return [note, *filter(None, [settles_sentence(q.scenario, [*q.study.axes, q.axis.name])])]


def settles_sentence(s: Scenario, axis_names: Iterable[str]) -> str:
    """Return a sentence if no observer is needed: the plant is known exactly and decays without noise; otherwise nothing."""
    if any(name in EXCITATIONS or name.startswith("plant.") for name in axis_names) or not settles_alone(s):
        return ""
    return (
        f"{s.name}: the plant decays by itself, equals its model, and has no process noise. So the model "
        "alone wins in the end, and nothing follows about periods or delays; add process noise (process_std)."
    )
