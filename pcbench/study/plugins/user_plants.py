"""Placeholders for user-defined plants, and user-defined scenarios as tables of a study.

Plants
    `study.toml` stores the facts of each user-defined plant: names, units, sizes, the linear model at the operating point. A
    result is read with these facts, without the plant's code. They are not enough to run it.

Scenarios
    Scenarios from files, installed packages and the study file itself become tables of the study:

        scenarios = ["cart/white", "mine.py:late"]      [scenarios.late]
                                                        use = "mine.py:late"
                                                        loss = 0.1

    MODULE:NAME is a dict with the keys of a table `[scenario]`. Its plant and its controller may be objects of that module, or
    names. Paths in it are relative to that file. Once read, it is data: a dataset does not need its code.
"""

from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.errors import UserError, brief_repr, short
from pcbench.plants import PlantSpec
from pcbench.plants.factory import tuples
from pcbench.protocols import Plant
from pcbench.scenarios import SCENARIOS
from pcbench.signal_names import pair
from pcbench.study import times
from pcbench.study.plugins import registry, user_code
from pcbench.study.plugins.references import SCENARIO, Gate, PluginReference
from pcbench.study.plugins.user_code import Code, UserPlugin
from pcbench.study.plugins.user_observers import ABSENT
from pcbench.toml_text import TomlTable

FUNCTIONS = ("model", "successor", "sensor")  # functions of a plant that observers may use
LINEAR = ("A", "B", "C", "D", "E")


def facts(entry: PlantSpec) -> TomlTable:
    """Return the facts of a plant that a dataset stores, as TOML values."""
    linear = entry.nominal(entry.numbers)
    matrices = {
        name: np.asarray(getattr(linear, name)).tolist() for name in LINEAR if getattr(linear, name) is not None
    }
    residual = {} if entry.residual is None else {"residual": np.asarray(entry.residual(entry.numbers)).tolist()}
    return {
        "summary": entry.summary,
        "signals": [list(p) for p in entry.signals],
        "unknowns": [list(p) for p in entry.unknowns],
        "numbers": {name: plain(value) for name, value in entry.numbers._asdict().items()},
        **({"errors": [list(p) for p in entry.errors]} if entry.errors else {}),
        **({"outputs": [list(p) for p in entry.outputs]} if entry.outputs else {}),
        "positive": list(entry.positive),
        "drifts": entry.drifts,
        "discrete": linear.discrete,
        "field": entry.plant.field is not None,
        "functions": [name for name in FUNCTIONS if getattr(entry, name) is not None],
        "linear": matrices,
        **residual,
    }


def absent(reference: str, code: Code, table: TomlTable) -> UserPlugin:
    """Return a placeholder for a plant of which only the facts are known."""
    placeholder = user_code.absent(reference)
    linear = {name: np.array(value, float) for name, value in table["linear"].items()}
    model = Model(linear["A"], linear["B"], linear["C"], linear.get("D"), table["discrete"], linear.get("E"))
    residual = np.array(table["residual"]) if "residual" in table else None
    numbers = namedtuple("Numbers", table["numbers"])(**{k: tuples(v) for k, v in table["numbers"].items()})  # type: ignore[misc]
    functions = {name: placeholder if name in table["functions"] else None for name in FUNCTIONS}
    spec = PlantSpec(
        plant=Plant(
            step=placeholder,
            output=placeholder,
            field=placeholder if table["field"] else None,
            errors=placeholder if "errors" in table else None,
            scored=len(table.get("errors", ())),
        ),
        signals=tuple(pair(name, unit, reference) for name, unit in table["signals"]),
        numbers=numbers,
        nominal=lambda numbers: model,
        prepare=placeholder,
        summary=ABSENT,
        unknowns=tuple(pair(name, unit, reference) for name, unit in table["unknowns"]),
        errors=tuple(pair(name, unit, reference) for name, unit in table.get("errors", ())),
        outputs=tuple(pair(name, unit, reference) for name, unit in table.get("outputs", ())),
        model=functions["model"],
        successor=functions["successor"],
        sensor=functions["sensor"],
        positive=tuple(table["positive"]),
        drifts=table["drifts"],
        residual=None if residual is None else lambda numbers: residual,
    )
    return UserPlugin(spec, code)


def collect_scenarios(raw: TomlTable, where: str, folder: Path | None, gate: Gate) -> TomlTable:
    """Return a raw study whose own scenarios are tables by name; raise UserError for one that cannot be read.

    `gate` controls access to code and files.
    """
    entries, tables = raw.get("scenarios"), dict(raw["tables"]) if isinstance(raw.get("tables"), dict) else {}
    names: list[object] = []
    if not isinstance(entries, dict | list):  # the schema reports the error
        entries = []
    if len(entries) > times.SCENARIOS:
        raise UserError(
            f"{where}: got {len(entries):,} scenarios, expected at most {times.SCENARIOS:,}; divide the study."
        )
    for name, table in entries.items() if isinstance(entries, dict) else [(n, {}) for n in entries]:
        place = f"{where}: scenarios.{short(str(name))}"
        if isinstance(name, str) and name in tables and not table:  # already read
            names.append(name)
            continue
        if not isinstance(table, dict):
            raise UserError(f"{place}: got {brief_repr(table)}, expected a table; write [scenarios.{name}].")
        if isinstance(name, str):
            if isinstance(use := table.get("use"), str):
                table = {k: v for k, v in table.items() if k != "use"} | {"base": use}
            if _is_user_scenario(name):
                table, name = {"base": name} | table, name.rpartition(":")[2]
            if _is_user_scenario(table.get("base")):
                table = _apply_base(table, place, folder, gate)
            if table and name in tables:
                raise UserError(f"{place}: got two scenarios called '{name}', expected one; write [scenarios.ANOTHER].")
            tables |= {name: table} if table else {}  # a built-in scenario has no table
        names.append(name)
    scenario = raw.get("scenario")
    if isinstance(scenario, dict) and _is_user_scenario(scenario.get("base")):
        raw = raw | {"scenario": _apply_base(scenario, f"{where}: scenario", folder, gate)}
    return raw | ({"scenarios": names} if entries else {}) | ({"tables": tables} if tables else {})


def _is_user_scenario(text: object) -> bool:
    """Return whether a text names a user-defined scenario."""
    if not isinstance(text, str) or text in SCENARIOS:
        return False
    return user_code.is_reference(text) or text in registry.find_plugins("scenario")


def _apply_base(table: TomlTable, where: str, folder: Path | None, gate: Gate) -> TomlTable:
    """Return a table over that of its user-defined `base`, as data.

    References of the base, to its module or to files next to it, are made valid from here.
    """
    plugin = registry.find_plugins(SCENARIO).get(table["base"])
    reference = plugin.reference if plugin else table["base"]
    user_code.split(reference, where)
    reference = reference if folder is None else user_code.resolve_reference(reference, folder)
    module, _ = user_code.split(reference, where)
    base_folder = Path(module).parent if user_code.is_file(module) else None
    base = dict(gate.code(PluginReference(SCENARIO, reference, reference), where).entry)
    base.pop("name", None)
    for key in ("plant", "controller"):
        value = base.get(key)
        if isinstance(value, registry.InModule):
            base[key] = f"{module}:{value.name}"
        elif isinstance(value, str) and base_folder is not None:
            base[key] = user_code.resolve_reference(value, base_folder)
    if isinstance(base.get("observers"), list | tuple) and base_folder is not None:
        base["observers"] = [
            user_code.resolve_reference(o, base_folder) if isinstance(o, str) else o for o in base["observers"]
        ]
    return {k: plain(v) for k, v in base.items()} | {k: v for k, v in table.items() if k != "base"}


def plain(value: object) -> Any:
    """Return arrays, tuples and ranges as the lists of a study, and NumPy numbers as Python numbers."""
    if hasattr(value, "tolist"):  # NumPy, JAX, pandas
        return plain(value.tolist())
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    return [plain(v) for v in value] if isinstance(value, tuple | list | range) else value
