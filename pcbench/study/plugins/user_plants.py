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
    said = {name: np.asarray(getattr(linear, name)).tolist() for name in LINEAR if getattr(linear, name) is not None}
    rest = {} if entry.residual is None else {"residual": np.asarray(entry.residual(entry.numbers)).tolist()}
    return {
        "summary": entry.summary,
        "signals": [list(each) for each in entry.signals],
        "unknowns": [list(each) for each in entry.unknowns],
        "numbers": {name: plain(value) for name, value in entry.numbers._asdict().items()},
        **({"errors": [list(each) for each in entry.errors]} if entry.errors else {}),
        **({"outputs": [list(each) for each in entry.outputs]} if entry.outputs else {}),
        "positive": list(entry.positive),
        "drifts": entry.drifts,
        "discrete": linear.discrete,
        "field": entry.plant.field is not None,
        "functions": [name for name in FUNCTIONS if getattr(entry, name) is not None],
        "linear": said,
        **rest,
    }


def absent(reference: str, code: Code, known: TomlTable) -> UserPlugin:
    """Return a placeholder for a plant of which only the facts are known."""
    nothing = user_code.absent(reference)
    linear = {name: np.array(value, float) for name, value in known["linear"].items()}
    model = Model(linear["A"], linear["B"], linear["C"], linear.get("D"), known["discrete"], linear.get("E"))
    rest = np.array(known["residual"]) if "residual" in known else None
    numbers = namedtuple("Numbers", known["numbers"])(**{k: tuples(v) for k, v in known["numbers"].items()})  # type: ignore[misc]
    functions = {name: nothing if name in known["functions"] else None for name in FUNCTIONS}
    there = PlantSpec(
        plant=Plant(
            step=nothing,
            output=nothing,
            field=nothing if known["field"] else None,
            errors=nothing if "errors" in known else None,
            scored=len(known.get("errors", ())),
        ),
        signals=tuple(pair(name, unit, reference) for name, unit in known["signals"]),
        numbers=numbers,
        nominal=lambda numbers: model,
        prepare=nothing,
        summary=ABSENT,
        unknowns=tuple(pair(name, unit, reference) for name, unit in known["unknowns"]),
        errors=tuple(pair(name, unit, reference) for name, unit in known.get("errors", ())),
        outputs=tuple(pair(name, unit, reference) for name, unit in known.get("outputs", ())),
        model=functions["model"],
        successor=functions["successor"],
        sensor=functions["sensor"],
        positive=tuple(known["positive"]),
        drifts=known["drifts"],
        residual=None if rest is None else lambda numbers: rest,
    )
    return UserPlugin(there, code)


def collect_scenarios(raw: TomlTable, where: str, folder: Path | None, gate: Gate) -> TomlTable:
    """Return a raw study whose own scenarios are tables by name; raise UserError for one that cannot be read.

    `gate` controls access to code and files.
    """
    given, tables = raw.get("scenarios"), dict(raw["tables"]) if isinstance(raw.get("tables"), dict) else {}
    names: list[object] = []
    if not isinstance(given, dict | list):  # the schema reports the error
        given = []
    if len(given) > times.SCENARIOS:
        raise UserError(
            f"{where}: got {len(given):,} scenarios, expected at most {times.SCENARIOS:,}; divide the study."
        )
    for name, table in given.items() if isinstance(given, dict) else [(each, {}) for each in given]:
        here = f"{where}: scenarios.{short(str(name))}"
        if isinstance(name, str) and name in tables and not table:  # already read
            names.append(name)
            continue
        if not isinstance(table, dict):
            raise UserError(f"{here}: got {brief_repr(table)}, expected a table; write [scenarios.{name}].")
        if isinstance(name, str):
            if isinstance(use := table.get("use"), str):
                table = {k: v for k, v in table.items() if k != "use"} | {"base": use}
            if _names_one(name):
                table, name = {"base": name} | table, name.rpartition(":")[2]
            if _names_one(table.get("base")):
                table = _apply_base(table, here, folder, gate)
            if table and name in tables:
                raise UserError(f"{here}: got two scenarios called '{name}', expected one; write [scenarios.ANOTHER].")
            tables |= {name: table} if table else {}  # a published scenario has no table
        names.append(name)
    scenario = raw.get("scenario")
    if isinstance(scenario, dict) and _names_one(scenario.get("base")):
        raw = raw | {"scenario": _apply_base(scenario, f"{where}: scenario", folder, gate)}
    return raw | ({"scenarios": names} if given else {}) | ({"tables": tables} if tables else {})


def _names_one(text: object) -> bool:
    """Return whether a text names a user-defined scenario."""
    if not isinstance(text, str) or text in SCENARIOS:
        return False
    return user_code.is_reference(text) or text in registry.find_plugins("scenario")


def _apply_base(table: TomlTable, where: str, folder: Path | None, gate: Gate) -> TomlTable:
    """Return a table over that of its user-defined `base`, as data.

    References of the base, to its module or to files next to it, are made valid from here.
    """
    found = registry.find_plugins(SCENARIO).get(table["base"])
    reference = found.reference if found else table["base"]
    user_code.split(reference, where)
    reference = reference if folder is None else user_code.resolve_reference(reference, folder)
    module, _ = user_code.split(reference, where)
    here = Path(module).parent if user_code.is_file(module) else None
    below = dict(gate.code(PluginReference(SCENARIO, reference, reference), where).entry)
    below.pop("name", None)
    for key in ("plant", "controller"):
        value = below.get(key)
        if isinstance(value, registry.InModule):
            below[key] = f"{module}:{value.name}"
        elif isinstance(value, str) and here is not None:
            below[key] = user_code.resolve_reference(value, here)
    if isinstance(below.get("observers"), list | tuple) and here is not None:
        below["observers"] = [
            user_code.resolve_reference(o, here) if isinstance(o, str) else o for o in below["observers"]
        ]
    return {k: plain(v) for k, v in below.items()} | {k: v for k, v in table.items() if k != "base"}


def plain(value: object) -> Any:
    """Return arrays, tuples and ranges as the lists of a study, and NumPy numbers as Python numbers."""
    if hasattr(value, "tolist"):  # NumPy, JAX, pandas
        return plain(value.tolist())
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, tuple | list | range) else value
