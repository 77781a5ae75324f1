"""The experiment as it was run, with its differences to the publication, and the options of its observers.

Only options that differ from their defaults are listed, each with its origin.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcbench.dataset.result import Result
from pcbench.fields import FIELDS
from pcbench.plants import entry_of, nonlinear, numbers_of, parameters_of, signals_of, states_of
from pcbench.plots import frames
from pcbench.plots.labels import quantity
from pcbench.plots.layout import number
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.scenarios.scenario import RECORD_OF, has_rows
from pcbench.scenarios.sources import Source, Sources, Table, Wave
from pcbench.study import LTI, Study, axes, merge_options, observers_of, scenarios_of, to_underscores
from pcbench.study.grid import Cell, cells
from pcbench.study.labels import base_in, entry_in
from pcbench.study.plugins.user_observers import ABSENT, is_absent

COMPARED = ("x0", *axes.AXES, "input", "unknown_input", "duration")  # fields that are compared with the publication
MANY = 8  # rows or columns up to which matrices are printed
LONG = 120  # letters of a value at most
ASSUMED = "assumed process noise per tick (std)"


class Fact(NamedTuple):
    """One line about an experiment."""

    what: str
    text: str
    varies: bool = False  # by an axis of the study: the values are all of them


class Experiment(NamedTuple):
    """The description of a scenario on the page."""

    source: str  # source, and the differences to it
    facts: list[Fact]
    matrices: list[tuple[str, list[list[str]]]]  # name, rows of numbers


def experiment(result: Result, scenario: str) -> Experiment:
    """Return the description of a scenario over all its grid points."""
    grid_cells = cells(result.study, scenario)
    s, study_axes = grid_cells[0].scenario, result.study.axes
    facts = [fact for row in _field_rows(s) if (fact := _fact(row, grid_cells, study_axes))]
    if all(c.scenario.belief.assumed_process_std == c.scenario.truth.process_std for c in grid_cells):
        facts = [fact for fact in facts if fact.what != ASSUMED]
    for name, values in study_axes.items():
        if name.startswith("plant."):
            what = f"plant parameter {name.removeprefix('plant.').replace('_', ' ')}"
            facts.append(Fact(what, " | ".join(map(_value_text, values)), len(values) > 1))
    numbers, matrices = numbers_of(s), list[tuple[str, list[list[str]]]]()
    if nonlinear(s):
        parameters = [f"{p} {number(getattr(numbers, p))}" for p in parameters_of(entry_of(s))]
        facts += [Fact("parameters", ", ".join(parameters))] if parameters else []
    else:
        model = entry_of(s).nominal(numbers)
        model_matrices = {"A": model.A, "B": model.B, "C": model.C, "D": model.D, "E": model.E}
        for name, m in ((name, np.asarray(m)) for name, m in model_matrices.items() if m is not None):
            if np.any(m) and max(m.shape) <= MANY:
                matrices.append((name, [[number(float(v)) for v in row] for row in m]))
    facts.append(Fact("observers", "; ".join(_observer(grid_cells[0], o) for o in grid_cells[0].options)))
    return Experiment(_describe_source(result, s, grid_cells), facts, matrices)


class Row(NamedTuple):
    """A field of a scenario: its title, the text of a value, and whether its default is shown too."""

    name: str
    title: str
    to_text: Callable[[Any], str]
    always: bool = False


def _times(values: str | Sequence[float | str]) -> str:
    return values if isinstance(values, str) else _each(values, ["s"] * len(values))


def _turns(values: Sequence[float | str]) -> str:
    first = [v if isinstance(v, str) else f"{number(v)} s" for v in values[:MANY]]
    return ", ".join(first) + (f" ... ({len(values)} in turn)" if len(values) > MANY else "")


def _percent(values: ArrayLike) -> str:
    return ", ".join(f"{number(100 * v)} %" for v in np.atleast_1d(values))


def _by_text(text: str, infinite: str = "") -> Callable[[Any], str]:
    def format_one(v: float) -> str:
        return infinite if v == np.inf else text.format(number(v))

    return lambda values: ", ".join(dict.fromkeys(map(format_one, np.atleast_1d(values))))


def _field_rows(s: Scenario) -> list[Row]:
    """Return the fields of a scenario that the page may show, in order."""
    signals, outputs = signals_of(s), frames.output_units(s)

    def states(values: ArrayLike) -> str:
        if np.ndim(values) > 1:  # a root of the covariance of a tick's noise
            norms = states(np.linalg.norm(np.asarray(values, float), axis=1))
            return f"{norms}, correlated by a matrix {' x '.join(map(str, np.shape(values)))}"
        pairs = zip(np.ravel(values), signals, strict=False)
        return ", ".join(f"{name.replace('_', ' ')} {quantity(number(float(v)), unit)}" for v, (name, unit) in pairs)

    forms = {
        "states": states,
        "times": _times,
        "turns": _turns,
        "percent": _percent,
        "outputs": lambda values: _each(values, outputs) if any(values) else "none",
    }
    first = [
        Row("plant", "plant", lambda name: _plant(s, name), always=True),
        Row("input", "input", _source, always=True),
        Row("controller", "loop", lambda name: f"closed by {name}"),
        Row("control", "options of the controller", _each_option),
        Row("unknown_input", "unknown input", _source),
        Row("x0", "initial state x(0)", states, always=True),
        Row("xhat0", "initial estimate xhat(0)", states, always=True),
        Row("prior_std", "prior std of x(0)", states, always=True),
    ]

    def each_row(to_text: Callable[[Any], str]) -> Callable[[Any], str]:
        return lambda values: " | ".join(map(to_text, values)) if has_rows(values) else to_text(values)

    field_rows = []
    for f in FIELDS:
        to_text = forms.get(f.form) or _by_text(f.form, f.infinite)
        field_rows.append(Row(f.name, f.title, each_row(to_text) if f.rows else to_text))
    last = [
        Row("assumed_process_std", ASSUMED, states),
        Row("parameters", "true parameters, if not nominal", _each_option),
        Row("delay_sine", "variation of the delays", lambda v: f"{number(v[0])} s sin({number(v[1])} t)"),
        Row("continuous", "measurements", lambda v: "continuous, without noise"),
        Row("initial_box", "random xhat(0) within", states),
        Row("duration", "duration", lambda v: f"{number(v)} s, in ticks of {number(s.dt)} s", always=True),
        Row("steady_start", "steady_start (steady_ metrics)", _by_text("{} s"), always=True),
        Row("settle_band", "settled within", states, always=True),
        Row(
            "divergence_threshold",
            "diverged beyond",
            lambda v: states(v) if isinstance(v, tuple) else number(v),
            always=True,
        ),
    ]
    return [*first, *field_rows, *last]


def _fact(row: Row, grid_cells: list[Cell], study_axes: Mapping[str, object]) -> Fact | None:
    """Return the line of a field over all grid points; None if it has its default at all of them."""
    values = list({str(v): v for c in grid_cells for v in (c.scenario.value(row.name),)}.values())
    record = RECORD_OF.get(row.name)
    scenario = grid_cells[0].scenario
    default = None if row.always or not record else getattr(scenario, record)._field_defaults.get(row.name)
    zeros = isinstance(values[0], tuple) and default == () and not any(np.ravel(values[0]))
    if not row.always and len(values) == 1 and (values[0] == default or zeros):
        return None
    loop = bool(scenario.loop.controller)
    unset = "same as the delay" if default is None and loop else "none" if default in (None, 0.0, (), "") else ""
    words = [unset if unset and v == default and not row.always else row.to_text(v) for v in values]
    return Fact(row.title, " | ".join(words), row.name in study_axes and len(values) > 1)


def _observer(cell: Cell, label: str) -> str:
    """Return an observer with the options that differ from its defaults."""
    options = {k: v for k, v in cell.options[label].model_dump(exclude_defaults=True).items() if v is not None}
    if not options or (label in cell.user_observers and is_absent(cell.user_observers[label])):
        return label
    return f"{label} ({', '.join(f'{k} {_value_text(v)}' for k, v in options.items())})"


def _describe_source(result: Result, s: Scenario, grid_cells: list[Cell]) -> str:
    """Return the source of a scenario, and the fields that this study has changed."""
    original = SCENARIOS.get(s.name)
    if original is None or s.user_code:
        return f"{s.summary[0].upper()}{s.summary[1:]}. Source: {s.source}." if s.name != LTI else ""
    names = [f.replace("_", " ") for f in COMPARED if any(c.scenario.value(f) != original.value(f) for c in grid_cells)]
    names += [name.removeprefix("plant.") for name in result.study.axes if name.startswith("plant.")]
    names += ["initial state (random)"] if grid_cells[0].choices.random_initial_state else []
    changes = f" This study changes: {', '.join(names)} (see below)." if names else ""
    return f"As published: {s.summary}. Source: {s.source}.{changes}"


def _plant(s: Scenario, name: str) -> str:
    """Return the summary of a plant, or its name if its code is not loaded."""
    summary, n_states = entry_of(s).summary, len(states_of(s))
    return f"linear plant of the study, {n_states} states" if name == LTI else name if summary == ABSENT else summary


def _source(sources: Sources) -> str:
    """Return an input in words."""
    parts = sources.split(",") if isinstance(sources, str) else sources
    return ", ".join(map(_one_source, parts)) or "none"


def _one_source(part: Source) -> str:
    if isinstance(part, Wave):
        unit, pace = f" {part.unit}" if part.unit else "", f", {number(part.frequency)} Hz" if part.frequency else ""
        return f"{part.shape} of {number(part.amplitude)}{unit}{pace}"
    return f"table of {len(part.t)} rows" if isinstance(part, Table) else str(part).strip()


def _each_option(options: Mapping[str, object]) -> str:
    """Return named values in words."""
    return ", ".join(f"{name} {_value_text(value)}" for name, value in options.items())


def _each(values: Sequence[float | str], units: list[str]) -> str:
    """Return one number if all channels are equal, otherwise all numbers with the names of their channels."""
    pairs = zip(values, units, strict=False)
    words = [quantity(number(v), unit) if not isinstance(v, str) else "one interval" for v, unit in pairs]
    names = [f"y{i + 1}" for i in range(len(words))]
    return words[0] if len(set(words)) == 1 else frames.name_values(names, words)


def _value_text(value: object) -> str:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return number(value)
    if isinstance(value, Mapping):
        return _each_option(value)
    return f"[{', '.join(map(_value_text, value))}]" if isinstance(value, list | tuple) else str(value)


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

    If the code of an observer is not loaded, its defaults are unknown, and all options of the study are returned.
    """
    study, options = result.study, dict[Option, None]()
    scenarios = scenarios_of(study)
    for scenario in study.scenarios:
        for observer in observers_of(study, scenario):
            options |= dict.fromkeys(_options(study, scenarios[scenario], observer))
    return list(options)


def _options(study: Study, scenario: Scenario, observer: str) -> list[Option]:
    entry = entry_in(study, observer)
    fields = {} if entry.summary == ABSENT else entry.options.model_fields
    labels = [base_in(study, observer) or observer, observer]
    study_keys = {key for label in labels for key in to_underscores(study.options.get(label, {}))}
    tuned = study.tuned.options.get(observer, {}) if study.tuned else {}
    options = []
    for name, value in merge_options(study, scenario, observer).items():
        default = fields[name].get_default(call_default_factory=True) if name in fields else None
        if name in fields and value == default:
            continue
        of_scenario = f"the scenario{f' {scenario.name}' if len(study.scenarios) > 1 else ''}"
        default_text = _word(default) if name in fields and not fields[name].is_required() else "-"
        is_tuned = name in tuned and tuned[name] == value
        first_cell = " at the first grid point" if is_tuned and study.tuned and study.tuned.cells else ""
        origin = "the study" if name in study_keys else of_scenario
        options.append(Option(observer, name, _word(value) + first_cell, default_text, is_tuned, origin))
    return options


def _word(value: object) -> str:
    if isinstance(value, float):
        return number(value)
    if isinstance(value, list | tuple):
        text = f"[{', '.join(_word(v) for v in value)}]"
        return text if len(text) <= LONG else f"{text[: LONG - 4]} ..."
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_word(one)}" for name, one in value.items())
    return "none" if value is None else str(value)
