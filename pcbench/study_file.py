"""Reading a study: from a name or a TOML file, with changes put in, checked before anything runs.

Every mistake ends in one sentence: where, what was found, what was expected, what to write instead.
"""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pcbench import axes as axis
from pcbench.cells import cells
from pcbench.errors import UserError, unknown
from pcbench.observers import OBSERVERS
from pcbench.scenarios import SCENARIOS
from pcbench.study import (
    OWN,
    STUDIES,
    Study,
    checked_options,
    labels_of,
    observers_of,
    options_of,
    scenarios_of,
    sentence,
)


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
        raise sentence(where, error, Study) from None
    known = scenarios_of(study, where)
    for name in study.scenarios:
        if name not in known:
            raise unknown(f"{where}: scenarios", "scenario", name, known)
    _unique(study.scenarios, f"{where}: scenarios")
    for name in study.observers or []:
        if name not in labels_of(study):
            raise unknown(f"{where}: observers", "observer", name, labels_of(study))
    if study.observers is not None:
        _unique(study.observers, f"{where}: observers")
        if not study.observers:
            raise UserError(f"{where}: observers: got an empty list, expected at least one of {', '.join(OBSERVERS)}.")
    for name, given in study.options.items():
        checked_options(name, given, f"{where}: options.{name}")
    for name in study.scenarios:
        every = cells(study, name, where)
        for observer in observers_of(study, name):
            options_of(study, known[name], observer)
            for cell in every:
                axis.works_on(observer, cell.scenario, where)
    return study


def _read(path: Path) -> dict[str, Any]:
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{path}: cannot be read ({reason}); expected a TOML file that describes a study.") from None
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


def _unique(names: list[str], where: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{where}: got '{name}' twice, expected each once; remove one.")
