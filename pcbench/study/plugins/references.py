"""Where a study names what is a user's own, MODULE:NAME: observers by their labels, plants and controllers where they stand."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

from pcbench.controllers import CONTROLLERS
from pcbench.plants import PLANTS
from pcbench.study.plugins import user_code
from pcbench.study.plugins.registry import find_plugins
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.toml_text import TomlTable

NAMES: dict[str, Collection[str]] = {"plant": PLANTS, "controller": CONTROLLERS}
KINDS = {"plant": "plant", "controller": "controller", "use": "controller"}  # of what the keys of tables name
SCENARIO = "scenario"  # the kind of a scenario that a raw study names, which its table replaces


class PluginReference(NamedTuple):
    """One place."""

    kind: str
    key: str  # by which a study finds what is named: the label of an observer, of others what the place says
    reference: str


class Gate(NamedTuple):
    """What a study may reach beside its own text. Whoever reads a study hands one in; there is no default."""

    code: Callable[
        [PluginReference, str], UserPlugin
    ]  # (what is named, where) -> the user's own object; raises UserError for a refusal
    files: bool  # whether it may name tables of inputs and logs, which are opened


def named_in(study: TomlTable) -> list[PluginReference]:
    """Return every name of what is a user's own in a study, as a dict."""
    found: list[PluginReference] = []

    def seen(each: PluginReference) -> str:
        if user_code.is_reference(each.reference):
            found.append(each)
        return each.reference

    replace_references(study, seen)
    return found


def replace_references(study: TomlTable, change: Callable[[PluginReference], str]) -> TomlTable:
    """Return a study, as a dict, with every name of what may be a user's own changed."""
    out = dict(study)
    if isinstance(use := out.get("custom_observers"), dict):
        mine = {label: text for label, text in use.items() if isinstance(text, str)}
        out["custom_observers"] = use | {
            label: change(PluginReference("observer", label, text)) for label, text in mine.items()
        }
    if isinstance(tables := out.get("tables"), dict):
        out["tables"] = {
            name: _replace_in_table(table, ("plant", "controller"), change) for name, table in tables.items()
        }
    if "scenario" in out:
        out["scenario"] = _replace_in_table(out["scenario"], ("plant", "controller"), change)
    if "controller" in out:
        out["controller"] = _replace_in_table(out["controller"], ("use",), change)
    return out


def _replace_in_table(table: object, keys: tuple[str, ...], change: Callable[[PluginReference], str]) -> object:
    """A table with the names in it changed; what is no table, or no name, as it is."""
    if not isinstance(table, dict):
        return table
    mine = {key: table[key] for key in keys if isinstance(table.get(key), str)}
    return table | {key: change(PluginReference(KINDS[key], text, text)) for key, text in mine.items()}


def looked_up(study: TomlTable) -> TomlTable:
    """Return a study, as a dict, whose plants and controllers of installed packages are named MODULE:NAME."""

    def found(each: PluginReference) -> str:
        if user_code.is_reference(each.reference) or each.kind == "observer" or each.reference in NAMES[each.kind]:
            return each.reference
        there = find_plugins(each.kind).get(each.reference)
        return there.reference if there else each.reference

    return replace_references(study, found)


def absolute(study: TomlTable, folder: Path | None = None) -> TomlTable:
    """Return a study, as a dict, whose files are found from every folder; relative paths are from `folder`, or from here."""
    here = Path().resolve() if folder is None else folder
    return replace_references(study, lambda each: user_code.resolve_reference(each.reference, here))
