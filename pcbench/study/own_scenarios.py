"""Scenarios of a user's own, made tables of a study: from files, from installed packages, from the study file itself.

    scenarios = ["cart/white", "mine.py:late"]      [scenarios.late]
                                                    use = "mine.py:late"
                                                    loss = 0.1

MODULE:NAME is a dict with the keys of a table `[scenario]`. Its plant and its controller may be objects of that module, or
names; paths in it are relative to that file. Read, it is data: a dataset needs no code of it.
"""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from pcbench.errors import UserError, short, shown
from pcbench.scenarios import SCENARIOS
from pcbench.study import own, own_entries

OBJECTS = {"plant": "plant", "controller": "controller"}  # by key: the kind of what may stand there as an object


def tabled(raw: dict[str, Any], where: str, folder: Path | None = None) -> dict[str, Any]:
    """Return a raw study whose own scenarios are tables by name; raise UserError for one that cannot be read."""
    given, tables = raw.get("scenarios"), dict(raw["tables"]) if isinstance(raw.get("tables"), dict) else {}
    names: list[Any] = []
    if not isinstance(given, dict | list):  # the model says what is wrong
        given = []
    for name, table in given.items() if isinstance(given, dict) else [(each, {}) for each in given]:
        here = f"{where}: scenarios.{short(str(name))}"
        if isinstance(name, str) and name in tables and not table:  # it has been read
            names.append(name)
            continue
        if not isinstance(table, dict):
            raise UserError(f"{here}: got {shown(table)}, expected a table; write [scenarios.{name}].")
        called, found = _one(name, table, here, folder) if isinstance(name, str) else (name, None)
        if found is not None and called in tables:
            raise UserError(f"{here}: got two scenarios called '{called}', expected one; write [scenarios.ANOTHER].")
        tables |= {} if found is None else {called: found}
        names.append(called)
    scenario = raw.get("scenario")
    if isinstance(scenario, dict) and _names_one(scenario.get("base")):
        raw = raw | {"scenario": _based(scenario, f"{where}: scenario", folder)}
    return raw | ({"scenarios": names} if given else {}) | ({"tables": tables} if tables else {})


def _one(name: str, table: dict[str, Any], where: str, folder: Path | None) -> tuple[str, dict[str, Any] | None]:
    """The name of one scenario with its table; no table where it is a published one."""
    if isinstance(use := table.get("use"), str):
        table = {k: v for k, v in table.items() if k != "use"} | {"base": use}
    if _names_one(name):
        return name.rpartition(":")[2], _based({"base": name} | table, where, folder)
    if _names_one(table.get("base")):
        return name, _based(table, where, folder)
    return name, table or None


def _names_one(text: Any) -> bool:
    """Whether a text names a scenario of a user's own."""
    if not isinstance(text, str) or text in SCENARIOS:
        return False
    return own.is_reference(text) or text in own_entries.installed("scenario")


def _based(table: dict[str, Any], where: str, folder: Path | None) -> dict[str, Any]:
    """A table with what its `base`, of a user's own, says beneath it."""
    base = table["base"]
    found = own_entries.installed("scenario").get(base)
    return load(found.reference if found else base, where, folder) | {k: v for k, v in table.items() if k != "base"}


def load(reference: str, where: str, folder: Path | None = None) -> dict[str, Any]:
    """Return the table that MODULE:NAME names, as data; raise UserError where it is none."""
    found = own_entries.load("scenario", reference, where, folder)
    loaded, (module, _) = own.module_of(found.code, where), own.split(reference, where)
    text = str((folder or Path()) / module) if found.code.files else module
    here = (folder or Path()) / Path(module).parent if found.code.files else None
    table = {key: value for key, value in found.entry.items() if key != "name"}
    for key, kind in OBJECTS.items():
        if key in table:
            table[key] = _name_of(table[key], kind, loaded, text, where, here)
    if isinstance(table.get("observers"), list | tuple) and here is not None:
        table["observers"] = [own.beside(o, here) if isinstance(o, str) else o for o in table["observers"]]
    return {key: plain(value) for key, value in table.items()}


def _name_of(value: Any, kind: str, loaded: ModuleType, module: str, where: str, here: Path | None) -> Any:
    """What stands in a table for an object of the same module, or for a name of a file beside it."""
    if isinstance(value, str):
        return own.beside(value, here) if here is not None else value
    names = [name for name, each in vars(loaded).items() if each is value]
    if not isinstance(value, own_entries.KINDS[kind].types) or not names:
        raise UserError(
            f"{where}.{kind}: got {own_entries.called(value)}, expected {own_entries.KINDS[kind].expected} that the same "
            "module holds, or a name; write that."
        )
    return f"{module}:{names[0]}"


def plain(value: Any) -> Any:
    """Return arrays and tuples as the lists that a study holds."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, tuple | list) else value
