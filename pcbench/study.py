"""What to run: scenarios x observers x axes x seeds, read from a name or a TOML file and checked before anything runs.

Every mistake ends in one sentence: where, what was found, what was expected, what to write instead.
"""

import hashlib
import itertools
import json
import tomllib
from pathlib import Path
from typing import Any, Literal, NamedTuple

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pcbench import axes as axis
from pcbench.axes import AXES
from pcbench.errors import UserError, unknown
from pcbench.observers import OBSERVERS, base_of, entry_of
from pcbench.own_plant import Lti
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.signals import SIGNALS

Values = list[Any]


OWN = "lti"  # the scenario of a study's own plant


class Choices(BaseModel):
    """`[options.scenario]`: choices left open by a scenario's source, for all scenarios of a study."""

    model_config = ConfigDict(extra="forbid")
    random_start: bool = Field(False, description="draw x(0) from N(xhat(0), P0) for each seed")
    input: str | None = Field(None, description="name of the input signal")
    drift_sign: Literal[-1, 1] = Field(1, description="the operator lost in print, in the cart's drift")


class Study(BaseModel):
    """A study as it stands in a TOML file; seconds and SI units."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(min_length=1, pattern=r"^[\w./+-]+$")
    scenarios: list[str] = Field(min_length=1)
    observers: list[str] | None = None
    seeds: int = Field(256, gt=0, le=10_000_000, strict=True)
    root_seed: int = Field(0, ge=0, lt=2**32, strict=True)
    axes: dict[str, Values] = {}
    options: dict[str, dict[str, Any]] = {}
    lti: Lti | None = None


STUDIES = {
    "quick": Study(name="quick", scenarios=["cart/nominal", "cart/white"], seeds=256),
    "cart": Study(
        name="cart",
        scenarios=[s for s in SCENARIOS if s.startswith("cart/") and not s.startswith("cart/variable")],
        seeds=1024,
    ),
    "variable-sampling": Study(
        name="variable-sampling",
        scenarios=["cart/variable", "cart/variable-bias", "cart/variable-gain"],
        seeds=256,
        axes={"profile": ["sine", "uniform"], "jitter": [0.0, 0.04], "loss": [0.0, 0.2]},
    ),
}


class Cell(NamedTuple):
    """One point of a study's axes in one scenario, every number resolved."""

    scenario: Scenario  # with the axes' values put in
    number: int  # from 0, within its scenario
    values: dict[str, Any]  # by axis, seconds and SI units: what the tables say
    parameters: dict[str, Any]  # the plant's, where the scenario or an axis changes them
    choices: Choices


def load(what: str, overrides: list[str] | None = None) -> Study:
    """Return a checked study from a built-in name, a scenario's name or a TOML file, with `key=value` overrides put in."""
    where = what
    if what in STUDIES:
        raw = STUDIES[what].model_dump(exclude_none=True)
    elif what in SCENARIOS:
        raw = {"name": what, "scenarios": [what]}
    elif what.endswith(".toml") or Path(what).is_file():
        raw = _read(Path(what))
    else:
        raise unknown("study", "study, scenario or TOML file", what, [*STUDIES, *SCENARIOS])
    for text in overrides or []:
        override(raw, text)
    return parse(raw, where)


def parse(raw: dict[str, Any], where: str) -> Study:
    """Return the study that `raw` describes; raise UserError naming the place in it that is wrong."""
    axes = raw.get("axes")
    if isinstance(axes, dict) and isinstance(axes.get("plant"), dict):  # `plant.lam = [...]` is a table to TOML
        nested = {f"plant.{name}": values for name, values in axes["plant"].items()}
        raw = raw | {"axes": {k: v for k, v in axes.items() if k != "plant"} | nested}
    if raw.get("lti") is not None and not raw.get("scenarios"):
        raw = raw | {"scenarios": [OWN]}
    try:
        study = Study.model_validate(raw)
    except ValidationError as error:
        raise _sentence(where, error, Study) from None
    known = scenarios_of(study, where)
    for name in study.scenarios:
        if name not in known:
            raise unknown(f"{where}: scenarios", "scenario", name, known)
    _unique(study.scenarios, f"{where}: scenarios")
    for name in study.observers or []:
        if not _named(study, name):
            raise unknown(f"{where}: observers", "observer", name, OBSERVERS)
    if study.observers is not None:
        _unique(study.observers, f"{where}: observers")
        if not study.observers:
            raise UserError(f"{where}: observers: got an empty list, expected at least one of {', '.join(OBSERVERS)}.")
    for name, given in study.options.items():
        _options(name, given, f"{where}: options.{name}")
    for name in study.scenarios:
        every = cells(study, name, where)
        for observer in observers_of(study, name):
            options_of(study, known[name], observer)
            for cell in every:
                axis.works_on(observer, cell.scenario, where)
    return study


def scenarios_of(study: Study, where: str | None = None) -> dict[str, Scenario]:
    """Return every scenario a study may name: the published ones, and `lti` where it brings a plant of its own."""
    return SCENARIOS if study.lti is None else SCENARIOS | {OWN: study.lti.scenario(OWN, f"{where or study.name}: lti")}


def _named(study: Study, label: str) -> bool:
    """Whether a label names an observer: its own name, or name-anything with options under that label."""
    return label in OBSERVERS or (base_of(label) is not None and label in study.options)


def observers_of(study: Study, scenario: str) -> list[str]:
    """Return the observers that run in a scenario: the study's, or else the scenario's own."""
    return list(study.observers or scenarios_of(study)[scenario].observers)


def options_of(study: Study, scenario: Scenario, observer: str) -> BaseModel:
    """Return an observer's options: the scenario's, with the study's put over them, the label's own over its name's."""
    given: dict[str, Any] = {}
    for label in dict.fromkeys([base_of(observer) or observer, observer]):
        given |= scenario.options.get(label, {}) | _dashes(study.options.get(label, {}))
    return _options(observer, given, f"{study.name}: options.{observer}")


def choices_of(study: Study) -> Choices:
    """Return the study's `[options.scenario]`."""
    return Choices.model_validate(_dashes(study.options.get("scenario", {})))


def cells(study: Study, scenario: str, where: str | None = None) -> list[Cell]:
    """Return every combination of the axes in one scenario, in the order of the axes as written."""
    base, where = scenarios_of(study)[scenario], where or study.name
    axes = {name: axis.axis(name, values, base, f"{where}: axes.{name}") for name, values in study.axes.items()}
    choices, out = choices_of(study), []
    for index, point in enumerate(itertools.product(*axes.values())):
        given = dict(zip(axes, point, strict=True))
        fields = {k: v for k, v in given.items() if k in AXES}
        changed = base._replace(**fields, input=choices.input or base.input)
        axis.fits(changed, where if where == scenario else f"{where}: {scenario}")
        values = {name: axis.plain(name, getattr(changed, name)) for name in AXES}
        own = {k.removeprefix("plant."): v for k, v in given.items() if k.startswith("plant.")}
        values |= {k: v for k, v in given.items() if k.startswith("plant.")}
        out.append(Cell(changed, index, values, dict(base.parameters) | own, choices))
    return out


def resolved(study: Study) -> dict[str, Any]:
    """Return everything that decides the numbers, for `study.toml` and its hash."""
    options: dict[str, Any] = {"scenario": choices_of(study).model_dump(exclude_none=True)}
    for scenario in study.scenarios:
        base = scenarios_of(study)[scenario]
        options[scenario] = {
            o: options_of(study, base, o).model_dump(exclude_none=True) for o in observers_of(study, scenario)
        }
    known = scenarios_of(study)
    scenarios = {s: _said(json.loads(json.dumps(known[s]._asdict(), default=dict))) for s in study.scenarios}
    out = study.model_dump(exclude_none=True)
    ran_by = {s: observers_of(study, s) for s in study.scenarios}
    return out | {"resolved": {"options": options, "scenarios": scenarios, "observers": ran_by}}


def _said(scenario: dict[str, Any]) -> dict[str, Any]:
    """A scenario without what TOML has no word for: a delay of one interval is written so."""
    delay = [axis.INTERVAL if d is None else d for d in scenario["delay"]]
    model = {k: v for k, v in scenario["model"].items() if v is not None}
    return scenario | {"delay": delay, "model": model}


def to_toml(study: Study) -> str:
    """Return the resolved study as TOML; the part under `[resolved]` is for readers, the rest can be run again."""
    return tomli_w.dumps(resolved(study))


def digest(study: Study) -> str:
    """Return the hash of the resolved study: equal for equal numbers."""
    return hashlib.sha256(json.dumps(resolved(study), sort_keys=True).encode()).hexdigest()


def _read(path: Path) -> dict[str, Any]:
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read ({error}); expected a TOML file that describes a study.") from None
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: is not valid TOML: {error}; mend that line.") from None
    raw.pop("resolved", None)
    return {"name": path.stem} | raw


def override(raw: dict[str, Any], change: str) -> None:
    """Put one `KEY=VALUE` into a raw study; VALUE is TOML, or a plain word."""
    key, equals, text = change.partition("=")
    path = [part.strip() for part in key.split(".", 1 if key.strip().startswith("axes.") else -1)]
    if not equals or not all(path):
        raise UserError(f"--set {change}: expected KEY=VALUE, such as axes.noise_std=0.1 or options.kfbo.R=0.3.")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    if path[0] == "axes" and len(path) > 1 and not isinstance(value, list):
        value = [value]
    for part in path[:-1]:
        raw = raw.setdefault(part, {})
        if not isinstance(raw, dict):
            raise UserError(f"--set {change}: {part} holds a value, not a table; expected KEY=VALUE below a table.")
    raw[path[-1]] = value


def _options(name: str, given: dict[str, Any], where: str) -> BaseModel:
    if name != "scenario" and base_of(name) is None:
        raise unknown(where, "observer with options (or 'scenario')", name, [*OBSERVERS, "scenario"])
    model = Choices if name == "scenario" else entry_of(name).options
    for key in _dashes(given):
        if key not in model.model_fields:
            raise unknown(where, "key here", key, [field.replace("_", "-") for field in model.model_fields])
    try:
        options = model.model_validate(_dashes(given))
    except ValidationError as error:
        raise _sentence(where, error, model) from None
    if isinstance(options, Choices) and options.input is not None and options.input not in SIGNALS:
        raise unknown(f"{where}.input", "input", options.input, SIGNALS)
    return options


def _dashes(given: dict[str, Any]) -> dict[str, Any]:
    return {key.replace("-", "_"): value for key, value in given.items()}


def _unique(names: list[str], where: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{where}: got '{name}' twice, expected each once; remove one.")


def _sentence(where: str, error: ValidationError, model: type[BaseModel]) -> UserError:
    """The first of pydantic's findings as a sentence."""
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        names = [name if model is Study else name.replace("_", "-") for name in model.model_fields]
        return unknown(where, "key here", str(first["loc"][-1]), names)
    if first["type"] == "missing":
        return UserError(f"{where}: {place} is missing; write {place} = ...")
    got = f"got {first['input']!r}, "
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return UserError(f"{where}: {place + ': ' if place else ''}{got}expected {message[0].lower() + message[1:]}.")
