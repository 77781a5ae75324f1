"""Load a study as a dict from a name, a TOML file or Python, with overrides. Its values are not checked yet."""

import os
from copy import deepcopy
from pathlib import Path

from pcbench import toml_text
from pcbench.errors import UserError, nearest_name, short, unknown
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS, parameters_of
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES, Choices, Study, empirical_delays, lti_inputs, underscore_keys
from pcbench.study import axes as axis
from pcbench.study.labels import each_table, resolve_labels
from pcbench.study.plugins import user_code
from pcbench.study.plugins.references import Gate, absolute, resolve_installed
from pcbench.study.plugins.user_plants import collect_scenarios, plain
from pcbench.toml_text import TomlTable

StudyLike = str | Path | TomlTable | Study  # a built-in name, a TOML file, or its content


def raw_of(source: StudyLike, overrides: list[str], gate: Gate) -> TomlTable:
    """Return a study as a dict with `key=value` overrides and _ for - in its keys; its values are not checked.

    `gate` controls access to code and files.
    """
    folder: Path | None = None
    if isinstance(source, Study):
        raw = deepcopy(source.model_dump(exclude_none=True))
    elif not isinstance(source, str | Path):
        raw = deepcopy(plain(dict(source)))
    elif (name := str(source)) in STUDIES:
        raw = STUDIES[name].model_dump(exclude_none=True)
    elif name in SCENARIOS:
        raw = {"name": name, "scenarios": [name]}
    elif user_code.is_reference(name):
        raw = {"name": name.rpartition(":")[2], "scenarios": [name]}
    elif name.endswith(".toml") or os.path.isfile(name):  # False for a name that is too long
        raw, folder = _read(Path(name)), Path(name).parent
    elif os.path.isdir(name):
        raise UserError(
            f"{short(name)}: got a folder, expected a study, a scenario or a TOML file; pcbench status shows what a folder of "
            "results holds."
        )
    else:
        nearest = nearest_name(name, names := [*STUDIES, *SCENARIOS])
        hint = f"did you mean '{nearest}'? " if nearest else ""
        raise UserError(
            f"study: '{short(name)}' is no study, scenario or TOML file; {hint}pcbench list shows all {len(names)} names."
        )
    for text in overrides:
        override(raw, text)
    if isinstance(source, str) and source in SCENARIOS and isinstance(changes := raw.get("scenario"), dict):
        raw["scenario"] = changes = {"name": f"{source}-changed", "base": source} | changes
        raw["scenarios"] = [changes["name"]]
    return normalize_raw(raw, where_of(source, raw), folder, gate)


def where_of(source: StudyLike, raw: TomlTable) -> str:
    """Return the name of a study in messages: the word or file by which it was requested, or else its name."""
    return str(source) if isinstance(source, str | Path) else str(raw.get("name", "study"))


def normalize_raw(raw: TomlTable, where: str, folder: Path | None, gate: Gate) -> TomlTable:
    """Return a raw study with _ for - in its keys, the table axes.plant as axes, and a single value of an axis as a list."""
    axes = raw.get("axes")
    if isinstance(axes, dict) and isinstance(axes.get("plant"), dict):  # TOML reads `plant.lam = [...]` as a table
        plant_axes = {f"plant.{name}": values for name, values in axes["plant"].items()}
        for key in plant_axes:
            if key in axes:
                raise UserError(f"{where}: axes: got {key} twice, expected each axis once; remove one.")
        raw = raw | {"axes": {k: v for k, v in axes.items() if k != "plant"} | plant_axes}
    raw = resolve_labels(collect_scenarios(underscore_keys(raw, where), where, folder, gate), where)
    raw = resolve_installed(raw) if folder is None else absolute(resolve_installed(raw), folder)
    for name in ("tune", "controller"):
        if isinstance(raw.get(name), dict):
            raw[name] = underscore_keys(raw[name], f"{where}: {name}")
    raw = each_table(raw, lambda table, place: _with_files(table, f"{where}: {place}", folder, gate))
    if isinstance(raw.get("axes"), dict):
        axes = underscore_keys(raw["axes"], f"{where}: axes", "plant.")
        raw["axes"] = {k: v if isinstance(v, list) else [v] for k, v in axes.items()}
    return raw


def _with_files(table: TomlTable, where: str, folder: Path | None, gate: Gate) -> TomlTable:
    """Return a scenario's table with _ for - in its keys and the content of the files it names, if the gate allows files."""
    table = underscore_keys(table, where)
    if not gate.files:
        for key in (*lti_inputs.files_in(table), *(["delay"] if empirical_delays.names_log(table) else [])):
            raise UserError(
                f"{where}.{key}: got '{short(table[key])}', expected numbers: the study of a dataset names no file; run the "
                "study again from its own file into a new folder."
            )
    table = lti_inputs.inline_csv_files(table, where, folder)
    base = SCENARIOS.get(table["base"]) if isinstance(table.get("base"), str) else None
    ticks = [float(v) for key in ("dt", "tick") if isinstance(v := table.get(key), int | float) and v > 0]
    return empirical_delays.resolve_delays(table, where, folder, (*ticks, base.dt if base else 1e-3)[0])


def override(raw: TomlTable, change: str) -> None:
    """Apply one `KEY=VALUE` to a raw study; VALUE is TOML, or a plain word."""
    key, equals, text = change.partition("=")
    name, where = key.strip().replace("-", "_"), f"--set {short(change)}"
    if "." not in name and name not in Study.model_fields:  # of an axis or an option, without its table
        if name in axis.AXES:
            places = [f"axes.{name}"]
        elif name in Choices.model_fields:
            places = [f"options.scenario.{name}"]
        else:
            places = [f"options.{o}.{name}" for o, entry in OBSERVERS.items() if name in entry.options.model_fields]
            places += [f"axes.plant.{name}" for plant in PLANTS.values() if name in parameters_of(plant)][:1]
        if places:
            raise UserError(f"{where}: '{short(key.strip())}' is no key of a study; write {' or '.join(places)}.")
        if equals:
            valid = [*Study.model_fields, "axes.AXIS", "options.OBSERVER.KEY"]
            raise unknown(where, "key of a study", key.strip(), valid)
    path = [part.strip() for part in key.split(".", 1 if key.strip().startswith("axes.") else -1)]
    if not equals or not all(path):
        raise UserError(f"{where}: expected KEY=VALUE, such as axes.noise_std=0.1 or options.kfbo.R=0.3.")
    try:
        table = toml_text.parse(f"value = {text}")
        value = table["value"] if len(table) == 1 else text.strip()
    except ValueError:
        value = text.strip()
    if path[0] == "axes" and len(path) > 1 and not isinstance(value, list):
        value = [value]
    for part in path[:-1]:
        raw = raw.setdefault(part, {})
        if not isinstance(raw, dict):
            raise UserError(f"{where}: {short(part)} contains a value, not a table; expected KEY=VALUE below a table.")
    raw[path[-1]] = value


def _read(path: Path) -> TomlTable:
    try:
        if path.exists() and not path.is_file():  # a folder, or a pipe, which would block
            raise OSError(0, "it is no file")
        text = path.read_text(encoding="utf-8-sig")  # with or without a byte-order mark
    except FileNotFoundError:
        raise UserError(
            f"{short(str(path))}: there is no such file; give a TOML file that describes a study."
        ) from None
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or an invalid name
        reason = getattr(error, "strerror", None) or error
        raise UserError(
            f"{short(str(path))}: cannot be read ({reason}); expected a TOML file that describes a study."
        ) from None
    try:
        raw = toml_text.parse(text)
    except ValueError as error:
        raise UserError(
            f"{path}: got what is not valid TOML ({short(str(error))}), expected a study; correct that line."
        ) from None
    raw.pop("resolved", None)
    return {"name": path.stem} | raw
