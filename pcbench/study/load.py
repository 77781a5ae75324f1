"""A study as it is written: a dict from a name, a TOML file or Python, with changes put in. Its values are not checked yet."""

from copy import deepcopy
from pathlib import Path
from typing import Any

from pcbench import toml_text
from pcbench.errors import UserError, short, unknown
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS, parameters_of
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES, Choices, Study, empirical_delays, lti_inputs, underscored
from pcbench.study import axes as axis
from pcbench.study.labels import labelled
from pcbench.study.plugins import user_code
from pcbench.study.plugins.references import Gate, absolute, looked_up
from pcbench.study.plugins.user_plants import plain, tabled

Described = str | Path | dict[str, Any] | Study  # a built-in name, a TOML file, or what one holds


def raw_of(what: Described, overrides: list[str], gate: Gate) -> dict[str, Any]:
    """Return a study as a dict, with `key=value` overrides put in and _ for - in its keys; its values are not checked.

    `gate` is what the study may reach beside its own text.
    """
    folder: Path | None = None
    if isinstance(what, Study):
        raw = deepcopy(what.model_dump(exclude_none=True))
    elif not isinstance(what, str | Path):
        raw = deepcopy(plain(dict(what)))
    elif (name := str(what)) in STUDIES:
        raw = STUDIES[name].model_dump(exclude_none=True)
    elif name in SCENARIOS:
        raw = {"name": name, "scenarios": [name]}
    elif user_code.is_reference(name):
        raw = {"name": name.rpartition(":")[2], "scenarios": [name]}
    elif name.endswith(".toml") or _is_file(name):
        raw, folder = _read(Path(name)), Path(name).parent
    elif _is_folder(name):
        raise UserError(
            f"{short(name)}: got a folder, expected a study, a scenario or a TOML file; pcbench status shows what a folder of "
            "results holds."
        )
    else:
        raise unknown("study", "study, scenario or TOML file", name, [*STUDIES, *SCENARIOS])
    for text in overrides:
        override(raw, text)
    return named(raw, where_of(what, raw), folder, gate)


def where_of(what: Described, raw: dict[str, Any]) -> str:
    """Return what a sentence calls a study: the word or file it was asked by, or else its name."""
    return str(what) if isinstance(what, str | Path) else str(raw.get("name", "study"))


def named(raw: dict[str, Any], where: str, folder: Path | None, gate: Gate) -> dict[str, Any]:
    """Return a raw study with _ for - in its keys, the table axes.plant as axes, and a single value of an axis as a list."""
    axes = raw.get("axes")
    if isinstance(axes, dict) and isinstance(axes.get("plant"), dict):  # `plant.lam = [...]` is a table to TOML
        nested = {f"plant.{name}": values for name, values in axes["plant"].items()}
        for key in nested:
            if key in axes:
                raise UserError(f"{where}: axes: got {key} twice, expected each axis once; remove one.")
        raw = raw | {"axes": {k: v for k, v in axes.items() if k != "plant"} | nested}
    raw = labelled(tabled(underscored(raw, where), where, folder, gate), where)
    raw = looked_up(raw) if folder is None else absolute(looked_up(raw), folder)
    for table in ("lti", "scenario", "tune", "controller"):
        if isinstance(raw.get(table), dict):
            raw[table] = underscored(raw[table], f"{where}: {table}")
    for name in raw.get("tables", ()) if isinstance(raw.get("tables"), dict) else ():
        if isinstance(raw["tables"][name], dict):
            here = f"{where}: scenarios.{name}"
            raw["tables"][name] = _opened(underscored(raw["tables"][name], here), here, folder, gate)
    for table in ("lti", "scenario"):
        if isinstance(raw.get(table), dict):
            raw[table] = _opened(raw[table], f"{where}: {table}", folder, gate)
    if isinstance(raw.get("axes"), dict):
        raw["axes"] = {
            k: v if isinstance(v, list) else [v]
            for k, v in underscored(raw["axes"], f"{where}: axes", "plant.").items()
        }
    return raw


def _opened(table: dict[str, Any], where: str, folder: Path | None, gate: Gate) -> dict[str, Any]:
    """A scenario's table with the numbers of the files that it names; raise UserError where the gate is closed to files."""
    if not gate.files:
        for key in (*lti_inputs.files_in(table), *(["delay"] if empirical_delays.names_log(table) else [])):
            raise UserError(
                f"{where}.{key}: got '{short(table[key])}', expected numbers: the study of a dataset names no file; run the "
                "study again from its own file into a new folder."
            )
    table = lti_inputs.filled(table, where, folder)
    return empirical_delays.resolved(table, where, folder, _tick(table))


def _tick(table: dict[str, Any]) -> float:
    """The tick of a table [s], as it says it or as that which it is based on has it."""
    base = SCENARIOS.get(table["base"]) if isinstance(table.get("base"), str) else None
    said = [table.get(key) for key in ("dt", "tick")]
    return next((float(v) for v in said if isinstance(v, int | float) and v > 0), base.dt if base else 1e-3)


def override(raw: dict[str, Any], change: str) -> None:
    """Put one `KEY=VALUE` into a raw study; VALUE is TOML, or a plain word."""
    key, equals, text = change.partition("=")
    _meant(key.strip(), change)
    path = [part.strip() for part in key.split(".", 1 if key.strip().startswith("axes.") else -1)]
    if not equals or not all(path):
        raise UserError(f"--set {short(change)}: expected KEY=VALUE, such as axes.noise_std=0.1 or options.kfbo.R=0.3.")
    try:
        found = toml_text.parse(f"value = {text}")
        value = found["value"] if len(found) == 1 else text.strip()
    except ValueError:
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
    """Raise UserError for the name of an axis, or of an option, given without its table."""
    if "." in key or key.replace("-", "_") in Study.model_fields:
        return
    name, found = key.replace("-", "_"), []
    if name in axis.AXES:
        found = [f"axes.{name}"]
    elif name in Choices.model_fields:
        found = [f"options.scenario.{name}"]
    else:
        found = [f"options.{o}.{name}" for o, entry in OBSERVERS.items() if name in entry.options.model_fields]
        found += [f"axes.plant.{name}" for plant in PLANTS.values() if name in parameters_of(plant)][:1]
    if found:
        raise UserError(f"--set {short(change)}: '{short(key)}' is no key of a study; write {' or '.join(found)}.")
    if change.partition("=")[1]:
        raise unknown(
            f"--set {short(change)}", "key of a study", key, [*Study.model_fields, "axes.AXIS", "options.OBSERVER.KEY"]
        )


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.exists() and not path.is_file():  # a folder, or a pipe, which would be waited for
            raise OSError(0, "it is no file")
        text = path.read_text(encoding="utf-8-sig")  # with or without a byte-order mark
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or no possible name
        reason = getattr(error, "strerror", None) or error
        raise UserError(
            f"{short(str(path))}: cannot be read ({reason}); expected a TOML file that describes a study."
        ) from None
    try:
        raw = toml_text.parse(text)
    except ValueError as error:
        raise UserError(
            f"{path}: got what is not valid TOML ({short(str(error))}), expected a study; mend that line."
        ) from None
    raw.pop("resolved", None)
    return {"name": path.stem} | raw


def _is_folder(what: str) -> bool:
    try:
        return Path(what).is_dir()
    except OSError:  # a name too long to be one
        return False


def _is_file(what: str) -> bool:
    try:
        return Path(what).is_file()
    except OSError:  # a name too long to be one
        return False
