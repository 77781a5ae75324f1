"""The experiment as it was run: what was true, what drove it, how it was measured; and what of that is not as published.

The options of each observer that differ from their defaults, and where they come from.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from pcbench.dataset.result import Result
from pcbench.plants import entry_of, nonlinear, numbers_of, parameters_of, signals_of, states_of
from pcbench.plots import frames
from pcbench.plots.labels import LTI
from pcbench.plots.layout import number
from pcbench.scenarios import INTERVAL, SCENARIOS, Scenario
from pcbench.scenarios.sources import Table, Wave
from pcbench.study import Study, dashes, given, observers_of, scenarios_of
from pcbench.study.grid import Cell, cells
from pcbench.study.labels import base_in, entry_in
from pcbench.study.plugins.user_observers import ABSENT, is_absent

TOLD = (  # fields of which is said that they are not as published
    *(
        "x0",
        "sampling_period",
        "delay",
        "noise_std",
        "process_std",
        "parameter_drift",
        "sampling_pattern",
        "sampling_jitter",
        "delay_jitter",
        *("delay_values", "delay_sequence", "delay_gamma_mean", "loss", "quantization_step"),
    ),
    *("input", "unknown_input", "actuator_delay", "assumed_delay_error", "duration"),
)
MANY = 8  # rows or columns up to which matrices are printed


class Fact(NamedTuple):
    """One thing that is known of an experiment."""

    what: str
    said: str
    changed: bool = False  # by an axis of the study: the values are all of them


class Experiment(NamedTuple):
    """What the page says of how a scenario was run."""

    published: str  # what it begins from, and what of that is not so here
    facts: list[Fact]
    matrices: list[tuple[str, list[list[str]]]]  # name, rows of numbers


def experiment(result: Result, scenario: str) -> Experiment:
    """Return how a scenario was run, over all its cells."""
    every = cells(result.study, scenario)
    s = every[0].scenario
    facts = [fact for each in _facts(s) if (fact := _fact(each, every, result.study.axes))]
    facts += [_parameter(name, values) for name, values in result.study.axes.items() if name.startswith("plant.")]
    facts += [Fact("parameters", known)] if (known := _parameters(s)) else []
    facts += [Fact("observers", "; ".join(_observer(every[0], o) for o in every[0].options))]
    return Experiment(_published(result, s, every), facts, _matrices(s))


class Field(NamedTuple):
    """A field of a scenario, how it is called, and how its value is said; `usual`: not said where it is that."""

    name: str
    what: str
    say: Callable[[Any], str]
    usual: Any = None


def _channels(say: Callable[[float], str]) -> Callable[[Any], str]:
    """What is said of a number, of each channel where they differ."""
    return lambda value: ", ".join(say(v) for v in value) if isinstance(value, tuple) else say(value)


def _facts(s: Scenario) -> list[Field]:
    """What is said of a scenario, in order; of what is not so usually only where it is."""
    signals, seen = signals_of(s), frames.output_units(s)

    def with_units(units: list[str]) -> Callable[[Any], str]:
        return lambda values: _each(values, units)

    seconds = with_units(["s"] * len(s.sampling.delay))
    return [
        Field("plant", "plant", lambda name: _plant(s, name)),
        Field("input", "input", _source),
        Field("controller", "loop", lambda name: f"closed by {name}", ""),
        Field(
            "control", "controller's options", lambda given: ", ".join(f"{k} {_plain(v)}" for k, v in given.items()), {}
        ),
        Field("unknown_input", "unknown input", _source, ""),
        Field("x0", "start x(0)", lambda v: _vector(v, signals)),
        Field("xhat0", "observers' start", lambda v: _vector(v, signals)),
        Field("prior_std", "std of the start", lambda v: _vector(v, signals)),
        Field("sampling_period", "a sample every", seconds),
        Field("delay", "each late by", lambda v: "one interval" if set(v) == {INTERVAL} else seconds(v)),
        Field("noise_std", "noise of a sample (std)", lambda v: _each(v, seen) if any(v) else "none"),
        Field(
            "process_std",
            "process noise a tick (std)",
            lambda v: _plain(v) if np.ndim(v) > 1 else _vector(v, signals),
            (),
        ),
        Field("parameter_drift", "parameter_drift", number, 0.0),
        Field(
            "sampling_pattern",
            "sampling intervals",
            lambda v: v if isinstance(v, str) else _each(v, ["s"] * len(v)),
            "periodic",
        ),
        Field("sampling_jitter", "sampling jitter", _channels(lambda v: f"± {number(v)} s"), 0.0),
        Field("delay_jitter", "delay jitter", _channels(lambda v: f"up to {number(v)} s more"), 0.0),
        Field("delay_values", "delays longer by, a Markov chain", lambda v: _each(v, ["s"] * len(v)), ()),
        Field("delay_self_transition", "chance to stay so", lambda v: ", ".join(map(number, v)), ()),
        Field("delay_sequence", "delays longer by, in turn", _in_turn, ()),
        Field("delay_weights", "shares of these, each by itself", lambda v: ", ".join(map(number, v)), ()),
        Field(
            "delay_gamma_mean",
            "delays longer by a gamma distribution's, mean",
            _channels(lambda v: f"{number(v)} s"),
            0.0,
        ),
        Field("delay_gamma_shape", "its shape", number, 1.0),
        Field("delay_sine", "delays swing by", lambda v: f"{number(v[0])} s sin({number(v[1])} t)", (0.0, 0.0)),
        Field("loss", "lost samples", _channels(lambda v: f"{number(100 * v)} %"), 0.0),
        Field("mean_burst_length", "lost in a row, mean", _channels(lambda v: f"{number(v)} samples"), 0.0),
        Field("sampling_phase", "first sample at", _channels(lambda v: f"{number(v)} s"), 0.0),
        Field("outage_start", "no sample arrives that is taken from", _channels(lambda v: f"{number(v)} s"), 0.0),
        Field("outage_duration", "for", _channels(lambda v: f"{number(v)} s"), 0.0),
        Field("quantization_step", "samples rounded to steps of", lambda v: _each(v, seen), ()),
        Field("dither", "dither", lambda v: "subtractive, over one step", 0.0),
        Field("timestamp_offset", "stamps ahead by", lambda v: f"{number(v)} s", 0.0),
        Field("clock_skew", "clock of stamps fast by", lambda v: f"{number(v)} ppm", 0.0),
        Field("timestamp_jitter", "stamps wrong by", lambda v: f"± {number(v)} s", 0.0),
        Field("outlier_probability", "outliers among samples", _channels(lambda v: f"{number(100 * v)} %"), 0.0),
        Field("outlier_scale", "noise of an outlier", _channels(lambda v: f"{number(v)} times a sample's"), 10.0),
        Field("student_t_dof", "noise of samples", lambda v: f"Student's t, {number(v)} degrees of freedom", math.inf),
        Field("continuous", "measured", lambda v: "continuously, without noise", False),
        Field("actuator_delay", "commands late by", lambda v: f"{number(v)} s", None),
        Field("assumed_delay_error", "observers believe samples older by", lambda v: f"{number(v)} s", 0.0),
        Field("assumed_noise_scale", "observers believe noise larger by", lambda v: f"{number(v)} times", 1.0),
        Field("initial_box", "observers' start, drawn within", lambda v: _vector(v, signals), ()),
        Field("duration", "duration", lambda v: f"{number(v)} s, in ticks of {number(s.dt)} s"),
        Field("steady_start", "tail (steady_ metrics) from", lambda v: f"{number(v)} s"),
        Field("settle_band", "settled within", lambda v: _vector(v, signals)),
        Field(
            "divergence_threshold",
            "diverged beyond",
            lambda v: _vector(v, signals) if isinstance(v, tuple) else number(v),
        ),
    ]


def _fact(field: Field, every: list[Cell], axes: dict[str, Any]) -> Fact | None:
    """What is to be said of a field over all cells; nothing where it is as usual in all of them."""
    values = list({str(v): v for c in every for v in (c.scenario.value(field.name),)}.values())
    if len(values) == 1 and (values[0] == field.usual or (isinstance(values[0], tuple) and field.usual == () and not any(
            np.ravel(values[0])))):  # fmt: skip
        return None
    usual = "none" if field.usual in (0.0, (), "") else "as the samples"
    said = [usual if v == field.usual else field.say(v) for v in values]
    return Fact(field.what, " | ".join(said), field.name in axes and len(values) > 1)


def _parameter(name: str, values: list[Any]) -> Fact:
    return Fact(
        f"{name.removeprefix('plant.').replace('_', ' ')} of the plant",
        " | ".join(map(_plain, values)),
        len(values) > 1,
    )


def _parameters(s: Scenario) -> str:
    """The parameters of a nonlinear plant; a linear one is said by its matrices."""
    numbers = numbers_of(s)
    return ", ".join(f"{p} {number(getattr(numbers, p))}" for p in parameters_of(entry_of(s))) if nonlinear(s) else ""


def _observer(cell: Cell, label: str) -> str:
    """An observer with the options that are not its own defaults."""
    given = cell.options[label]
    own = {k: v for k, v in given.model_dump(exclude_defaults=True).items() if v is not None}
    if label in cell.own and is_absent(cell.own[label]):
        return label
    return f"{label} ({', '.join(f'{k} {_plain(v)}' for k, v in own.items())})" if own else label


def _published(result: Result, s: Scenario, every: list[Cell]) -> str:
    """What a scenario begins from, and which of its fields this study has changed."""
    known = SCENARIOS.get(s.name)
    if known is None or s.own:
        return f"{s.summary[0].upper()}{s.summary[1:]}. Source: {s.source}." if s.name != LTI else ""
    differ = [f.replace("_", " ") for f in TOLD if any(c.scenario.value(f) != known.value(f) for c in every)]
    differ += [name.removeprefix("plant.") for name in result.study.axes if name.startswith("plant.")]
    differ += ["start (random)"] if every[0].choices.random_initial_state else []
    but = f" Here another: {', '.join(differ)}; as below." if differ else ""
    return f"As published: {s.summary}. Source: {s.source}.{but}"


def _matrices(s: Scenario) -> list[tuple[str, list[list[str]]]]:
    """The matrices of the nominal model; a nonlinear plant is said by its parameters."""
    if nonlinear(s):
        return []
    model = entry_of(s).nominal(numbers_of(s))
    named = {"A": model.A, "B": model.B, "C": model.C, "D": model.D, "E": model.E}
    found = {k: np.asarray(v) for k, v in named.items() if v is not None and np.any(np.asarray(v))}
    return [(k, [[number(float(v)) for v in row] for row in m]) for k, m in found.items() if max(m.shape) <= MANY]


def _plant(s: Scenario, name: str) -> str:
    """What a plant is; of one whose code is not here, its name."""
    summary, many = entry_of(s).summary, len(states_of(s))
    return f"of the study, linear, {many} states" if name == LTI else name if summary == ABSENT else summary


def _source(given: Any) -> str:
    """An input in words."""
    parts = given.split(",") if isinstance(given, str) else given
    return ", ".join(map(_one_source, parts)) or "none"


def _one_source(part: Any) -> str:
    if isinstance(part, Wave):
        unit, pace = f" {part.unit}" if part.unit else "", f", {number(part.frequency)} Hz" if part.frequency else ""
        return f"{part.shape} of {number(part.amplitude)}{unit}{pace}"
    return f"a table of {len(part.t)} rows" if isinstance(part, Table) else str(part).strip()


def _vector(values: Any, signals: Any) -> str:
    """Numbers with the names and units of the signals that they are of."""
    named = zip(np.ravel(values), signals, strict=False)
    return ", ".join(f"{name.replace('_', ' ')} {number(float(v))} {unit}".strip() for v, (name, unit) in named)


def _in_turn(values: Any) -> str:
    """Delays in turn: the first of them, and how many there are."""
    said = [f"{number(v)} s" if not isinstance(v, str) else v for v in values[:MANY]]
    return ", ".join(said) + (f" ... ({len(values)} in turn)" if len(values) > MANY else "")


def _each(values: Any, units: list[str]) -> str:
    """One number where all channels are alike, or all of them."""
    said = [
        f"{number(v)} {u}".strip() if not isinstance(v, str) else "one interval"
        for v, u in zip(values, units, strict=False)
    ]
    return said[0] if len(set(said)) == 1 else ", ".join(said)


def _plain(value: Any) -> str:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return number(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return str(value)


LONG = 120  # letters of a value at most


class Option(NamedTuple):
    """One option of an observer."""

    observer: str
    name: str
    value: str
    default: str
    tuned: bool
    origin: str


def rows(result: Result) -> list[Option]:
    """Return the options of a study's observers that differ from their defaults, in the order of the study.

    Of an observer whose code is left alone the defaults are not known: all options that were given are returned.
    """
    study, found = result.study, list[Option]()
    known = scenarios_of(study)
    for name in study.scenarios:
        for observer in observers_of(study, name):
            found += [o for o in _of(study, known[name], observer, len(study.scenarios) > 1) if o not in found]
    return found


def _of(study: Study, scenario: Any, observer: str, several: bool) -> list[Option]:
    entry = entry_in(study, observer)
    fields = {} if entry.summary == ABSENT else entry.options.model_fields
    labels = [base_in(study, observer) or observer, observer]
    set_here = {key for label in labels for key in dashes(study.options.get(label, {}))}
    tuned = study.tuned.options.get(observer, {}) if study.tuned else {}
    found = []
    for name, value in given(study, scenario, observer).items():
        default = fields[name].get_default(call_default_factory=True) if name in fields else None
        if name in fields and value == default:
            continue
        origin = "the study" if name in set_here else f"the scenario{f' {scenario.name}' if several else ''}"
        was = _word(default) if name in fields and not fields[name].is_required() else "-"
        is_tuned = name in tuned and tuned[name] == value
        if is_tuned and study.tuned and study.tuned.cells:
            found.append(Option(observer, name, f"{_word(value)} in the first cell", was, True, origin))
            continue
        found.append(Option(observer, name, _word(value), was, is_tuned, origin))
    return found


def _word(value: Any) -> str:
    if isinstance(value, float):
        return number(value)
    if isinstance(value, list | tuple):
        text = f"[{', '.join(_word(v) for v in value)}]"
        return text if len(text) <= LONG else f"{text[: LONG - 4]} ..."
    return "none" if value is None else str(value)
