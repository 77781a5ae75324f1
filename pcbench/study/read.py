"""Reading a study: from a name or a TOML file, with changes put in, checked before anything runs.

Every mistake ends in one sentence: where, what was found, what was expected, what to write instead.
"""

import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pcbench.errors import UserError, short, unknown
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS, parameters_of, signals_of
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.study import (
    OWN,
    STUDIES,
    Choices,
    Study,
    checked_options,
    fits,
    labels_of,
    observers_of,
    options_of,
    scenarios_of,
    sentence,
    underscored,
)
from pcbench.study import axes as axis
from pcbench.study.cells import Cell, cells

Described = str | Path | dict[str, Any] | Study  # a built-in name, a TOML file, or what one holds
NOT_TOML = (ValueError, RecursionError)  # what tomllib raises: also of numbers too long, and of lists too deep


def load(what: str, overrides: list[str] | None = None) -> Study:
    """Return a checked study from a built-in name, a scenario's name or a TOML file, with `key=value` overrides put in."""
    where = what
    if what in STUDIES:
        raw = STUDIES[what].model_dump(exclude_none=True)
    elif what in SCENARIOS:
        raw = {"name": what, "scenarios": [what]}
    elif what.endswith(".toml") or _is_file(what):
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
        for key in nested:
            if key in axes:
                raise UserError(f"{where}: axes: got {key} twice, expected each axis once; remove one.")
        raw = raw | {"axes": {k: v for k, v in axes.items() if k != "plant"} | nested}
    raw = _named(raw, where)
    if raw.get("lti") is not None and not raw.get("scenarios"):
        raw = raw | {"scenarios": [OWN]}
    try:
        study = Study.model_validate(raw)
    except ValidationError as error:
        raise sentence(where, error, Study) from None
    known = scenarios_of(study, where)
    for name in study.scenarios:
        if name not in known:
            raise unknown(f"{where}: scenarios", "scenario", name, known)
    _unique(study.scenarios, f"{where}: scenarios")
    if study.observers is not None:
        _observers(study, study.observers, f"{where}: observers")
    if study.lti is not None:
        _observers(study, study.lti.observers, f"{where}: lti.observers")
    for name, given in study.options.items():
        checked_options(name, given, f"{where}: options.{name}")
    for name in study.scenarios:
        every = cells(study, name, where)
        for observer in observers_of(study, name):
            options_of(study, known[name], observer)
            for cell in every:
                fits.works_on(observer, cell.scenario, where)
    return study


def _named(raw: dict[str, Any], where: str) -> dict[str, Any]:
    """A raw study with keys as Python names them, written with - or _, and with a single value of an axis as a list."""
    raw = underscored(raw, where)
    for table in ("lti", "tune"):
        if isinstance(raw.get(table), dict):
            raw[table] = underscored(raw[table], f"{where}: {table}")
    if isinstance(raw.get("axes"), dict):
        raw["axes"] = {
            k: v if isinstance(v, list) else [v]
            for k, v in underscored(raw["axes"], f"{where}: axes", "plant.").items()
        }
    return raw


def study_of(study: Described, changes: dict[str, Any], overrides: list[str]) -> Study:
    """Return a checked study from a name, a TOML file, a dict or a Study, with top-level `changes` put in."""
    if isinstance(study, str | Path):
        study, overrides = load(str(study), overrides), []
    raw = deepcopy(study.model_dump(exclude_none=True) if isinstance(study, Study) else dict(study))
    for change in overrides:
        override(raw, change)
    raw |= {key: value for key, value in changes.items() if value is not None}
    return parse(raw, str(raw.get("name", "study")))


def one_cell(what: Described, observers: list[str], overrides: list[str]) -> tuple[Study, Cell]:
    """Return a study of some observers in one scenario with its one cell; raise UserError where there are more."""
    study = study_of(study_of(what, {}, overrides), {"observers": observers}, [])
    every = [cell for name in study.scenarios for cell in cells(study, name)]
    if len(every) > 1:
        raise UserError(
            f"{study.name}: got {len(every)} cells, expected one here; name one scenario, each axis with one value."
        )
    return study, every[0]


def scenario_of(what: str, overrides: list[str] | None = None) -> Scenario:
    """Return the one scenario that a name or a TOML file stands for; raise UserError where there are more."""
    study = load(what, overrides)
    if len(study.scenarios) > 1:
        raise UserError(f"{what}: got {len(study.scenarios)} scenarios, expected one here; name a scenario.")
    return scenarios_of(study)[study.scenarios[0]]


def _observers(study: Study, names: list[str], where: str) -> None:
    """Raise UserError where a list of observers is empty, or holds a name that is none or stands there twice."""
    if not names:
        raise UserError(f"{where}: got an empty list, expected at least one of {', '.join(OBSERVERS)}.")
    for name in names:
        if name not in labels_of(study):
            raise unknown(where, "observer", name, labels_of(study))
    _unique(names, where)


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.exists() and not path.is_file():  # a folder; or a pipe, for which one would wait
            raise OSError(0, "it is no file")
        text = path.read_text(encoding="utf-8-sig")  # with a mark of the byte order or without
    except (OSError, ValueError) as error:  # ValueError: no UTF-8, or a name that cannot be one
        reason = getattr(error, "strerror", None) or error
        raise UserError(
            f"{short(str(path))}: cannot be read ({reason}); expected a TOML file that describes a study."
        ) from None
    try:
        raw = tomllib.loads(text)
    except NOT_TOML as error:
        raise UserError(
            f"{path}: got what is not valid TOML ({short(str(error))}), expected a study; mend that line."
        ) from None
    raw.pop("resolved", None)
    return {"name": path.stem} | raw


def _is_file(what: str) -> bool:
    try:
        return Path(what).is_file()
    except OSError:  # a name too long to be one
        return False


def override(raw: dict[str, Any], change: str) -> None:
    """Put one `KEY=VALUE` into a raw study; VALUE is TOML, or a plain word."""
    key, equals, text = change.partition("=")
    _meant(key.strip(), change)
    path = [part.strip() for part in key.split(".", 1 if key.strip().startswith("axes.") else -1)]
    if not equals or not all(path):
        raise UserError(f"--set {short(change)}: expected KEY=VALUE, such as axes.noise_std=0.1 or options.kfbo.R=0.3.")
    try:
        found = tomllib.loads(f"value = {text}")
        value = found["value"] if len(found) == 1 else text.strip()
    except NOT_TOML:
        value = text.strip()
    if path[0] == "axes" and len(path) > 1 and not isinstance(value, list):
        value = [value]
    for part in path[:-1]:
        raw = raw.setdefault(part, {})
        if not isinstance(raw, dict):
            raise UserError(
                f"--set {short(change)}: {short(part)} holds a value, not a table; expected KEY=VALUE below a table."
            )
    raw[path[-1]] = value


def _meant(key: str, change: str) -> None:
    """Raise UserError for the name of an axis, or of an option, that stands without its table."""
    if "." in key or key.replace("-", "_") in Study.model_fields:
        return
    name, found = key.replace("-", "_"), []
    if name in axis.AXES:
        found = [f"axes.{name}"]
    elif name in Choices.model_fields:
        found = [f"options.scenario.{name}"]
    else:
        found = [f"options.{o}.{name}" for o, entry in OBSERVERS.items() if name in entry.options.model_fields]
        found += [f"axes.plant.{name}" for plant in PLANTS if name in parameters_of(plant)][:1]
    if found:
        raise UserError(f"--set {short(change)}: '{short(key)}' is no key of a study; write {' or '.join(found)}.")
    if change.partition("=")[1]:
        raise unknown(
            f"--set {short(change)}", "key of a study", key, [*Study.model_fields, "axes.AXIS", "options.OBSERVER.KEY"]
        )


def require_signals(study: Study, names: list[str] | None, where: str) -> None:
    """Raise UserError for a signal that no scenario of a study has."""
    known = scenarios_of(study)
    there = [signal for name in study.scenarios for signal, _ in signals_of(known[name])]
    for name in names or []:
        if name not in there:
            raise unknown(where, f"signal of {study.name}", name, set(there))


def _unique(names: list[str], where: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{where}: got '{name}' twice, expected each once; remove one.")
