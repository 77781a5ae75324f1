"""What to run: scenarios x observers x axes x seeds, read from a name or a TOML file and checked before anything runs.

Every mistake ends in one sentence: where, what was found, what was expected, what to write instead.
"""

import hashlib
import itertools
import json
import math
import tomllib
from pathlib import Path
from typing import Any, Literal, NamedTuple

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pcbench.errors import UserError, unknown
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.signals import SIGNALS

SMALLEST = 1e-12
LARGEST = 1e12  # no number of a scenario is larger, in SI units
AXES = ("sampling_period", "delay", "noise_std", "drift")
Values = list[Any]


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


STUDIES = {
    "quick": Study(name="quick", scenarios=["cart/nominal", "cart/white"], seeds=256),
    "cart": Study(name="cart", scenarios=[s for s in SCENARIOS if s.startswith("cart/")], seeds=1024),
}


class Cell(NamedTuple):
    """One point of a study's axes in one scenario, every number resolved."""

    scenario: Scenario  # with the axes' values put in
    number: int  # from 0, within its scenario
    values: dict[str, Any]  # by axis, seconds and SI units: what the tables say
    parameters: dict[str, float]  # the plant's, where an axis changes them
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
    try:
        study = Study.model_validate(raw)
    except ValidationError as error:
        raise _sentence(where, error, Study) from None
    for name in study.scenarios:
        if name not in SCENARIOS:
            raise unknown(f"{where}: scenarios", "scenario", name, SCENARIOS)
    _unique(study.scenarios, f"{where}: scenarios")
    for name in study.observers or []:
        if name not in OBSERVERS:
            raise unknown(f"{where}: observers", "observer", name, OBSERVERS)
    if study.observers is not None:
        _unique(study.observers, f"{where}: observers")
        if not study.observers:
            raise UserError(f"{where}: observers: got an empty list, expected at least one of {', '.join(OBSERVERS)}.")
    for name, given in study.options.items():
        _options(name, given, f"{where}: options.{name}")
    for name in study.scenarios:
        cells(study, name, where)
        for observer in observers_of(study, name):
            options_of(study, SCENARIOS[name], observer)
    return study


def observers_of(study: Study, scenario: str) -> list[str]:
    """Return the observers that run in a scenario: the study's, or else the scenario's own."""
    return list(study.observers or SCENARIOS[scenario].observers)


def options_of(study: Study, scenario: Scenario, observer: str) -> BaseModel:
    """Return an observer's options: the scenario's, with the study's put over them."""
    given = scenario.options.get(observer, {}) | _dashes(study.options.get(observer, {}))
    return _options(observer, given, f"{study.name}: options.{observer}")


def choices_of(study: Study) -> Choices:
    """Return the study's `[options.scenario]`."""
    return Choices.model_validate(_dashes(study.options.get("scenario", {})))


def cells(study: Study, scenario: str, where: str | None = None) -> list[Cell]:
    """Return every combination of the axes in one scenario, in the order of the axes as written."""
    base, where = SCENARIOS[scenario], where or study.name
    axes = {name: _axis(name, values, base, f"{where}: axes.{name}") for name, values in study.axes.items()}
    out = []
    for index, point in enumerate(itertools.product(*axes.values())):
        given = dict(zip(axes, point, strict=True))
        fields = {k: v for k, v in given.items() if k in AXES}
        changed = base._replace(**fields, input=choices_of(study).input or base.input)
        values = {name: _plain(getattr(changed, name)) for name in AXES}
        parameters = {k.removeprefix("plant."): v for k, v in given.items() if k.startswith("plant.")}
        values |= {k: v for k, v in given.items() if k.startswith("plant.")}
        out.append(Cell(changed, index, values, parameters, choices_of(study)))
    return out


def resolved(study: Study) -> dict[str, Any]:
    """Return everything that decides the numbers, for `study.toml` and its hash."""
    options: dict[str, Any] = {"scenario": choices_of(study).model_dump(exclude_none=True)}
    for scenario in study.scenarios:
        base = SCENARIOS[scenario]
        options[scenario] = {
            o: options_of(study, base, o).model_dump(exclude_none=True) for o in observers_of(study, scenario)
        }
    scenarios = {s: json.loads(json.dumps(SCENARIOS[s]._asdict(), default=dict)) for s in study.scenarios}
    out = study.model_dump(exclude_none=True)
    ran_by = {s: observers_of(study, s) for s in study.scenarios}
    return out | {"resolved": {"options": options, "scenarios": scenarios, "observers": ran_by}}


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
    if name != "scenario" and name not in OBSERVERS:
        raise unknown(where, "observer with options (or 'scenario')", name, [*OBSERVERS, "scenario"])
    model = Choices if name == "scenario" else OBSERVERS[name].options
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


def _axis(name: str, values: Values, base: Scenario, where: str) -> Values:
    parameters = [f"plant.{p}" for p in PLANTS[base.plant].numbers._fields if not p.startswith("drift")]
    if name not in AXES and name not in parameters:
        raise unknown(where, f"axis of {base.name}", name, [*AXES, *parameters])
    if not values:
        raise UserError(f"{where}: got an empty list, expected at least one value; leave the axis out or fill it.")
    out = [_point(name, value, base, f"{where}[{i}]") for i, value in enumerate(values)]
    if len({str(v) for v in out}) < len(out):
        raise UserError(f"{where}: got a value twice in {values}, expected each once; remove the repeated one.")
    return out


def _point(name: str, value: Any, base: Scenario, where: str) -> Any:
    channels = len(base.delay)
    if name in ("drift",) or name.startswith("plant."):
        return _number(value, where, least=None)
    each = value if isinstance(value, list) else [value] * channels
    if len(each) != channels:
        raise UserError(
            f"{where}: got {len(each)} values, expected one or {channels} (a value for each output channel)."
        )
    numbers = [_number(v, where, least=0.0) for v in each]
    if name in ("sampling_period", "delay"):
        for v in numbers:
            _whole_ticks(name, v, base, where)
    return tuple(numbers)


def _number(value: Any, where: str, least: float | None) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError(f"{where}: got {value!r}, expected a finite number; write a number in SI units.")
    if abs(value) > LARGEST:
        raise UserError(f"{where}: got {value!r}, expected a number of at most {LARGEST:g} in size; write SI units.")
    if 0 < abs(value) < SMALLEST:
        raise UserError(f"{where}: got {value!r}, expected 0 or a number of at least {SMALLEST:g} in size; write 0.")
    if least is not None and value < least:
        raise UserError(
            f"{where}: got {value!r}, expected a number of at least {least:g}; change its sign or leave it out."
        )
    return float(value)


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
    if value > base.horizon:
        raise UserError(f"{where}: got {value:g} s, expected at most the horizon of {base.name}, {base.horizon:g} s.")


def _plain(value: Any) -> Any:
    """A tuple of equal channels as one number, of different ones as a list."""
    if isinstance(value, tuple):
        return value[0] if len(set(value)) == 1 else list(value)
    return value


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
