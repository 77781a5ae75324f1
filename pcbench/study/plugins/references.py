"""References MODULE:NAME in a study: observers by label, plants and controllers in the tables that name them."""

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
KINDS = {"plant": "plant", "controller": "controller", "use": "controller"}  # kind of plugin by the key that names it
SCENARIO = "scenario"  # a scenario's reference in a raw study is replaced by its table


class PluginReference(NamedTuple):
    """One reference in a study."""

    kind: str
    key: str  # an observer's label; for others the reference itself
    reference: str


class Gate(NamedTuple):
    """Access of a study to code and files. Whoever parses a study supplies it; there is no default."""

    # (reference, place) -> the user-defined object; raises UserError to refuse
    code: Callable[[PluginReference, str], UserPlugin]
    files: bool  # whether it may name tables of inputs and recordings, which are opened


def references_in(study: TomlTable) -> list[PluginReference]:
    """Return every reference to user-defined code in a study, as a dict."""
    references: list[PluginReference] = []

    def collect(reference: PluginReference) -> str:
        if user_code.is_reference(reference.reference):
            references.append(reference)
        return reference.reference

    replace_references(study, collect)
    return references


def replace_references(study: TomlTable, change: Callable[[PluginReference], str]) -> TomlTable:
    """Return a study, as a dict, with every possible reference to user-defined code changed by `change`."""
    out = dict(study)
    if isinstance(custom := out.get("custom_observers"), dict):
        by_label = {label: text for label, text in custom.items() if isinstance(text, str)}
        out["custom_observers"] = custom | {
            label: change(PluginReference("observer", label, text)) for label, text in by_label.items()
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
    """Return a table with its references changed; anything else is returned unchanged."""
    if not isinstance(table, dict):
        return table
    texts = {key: table[key] for key in keys if isinstance(table.get(key), str)}
    return table | {key: change(PluginReference(KINDS[key], text, text)) for key, text in texts.items()}


def resolve_installed(study: TomlTable) -> TomlTable:
    """Return a study, as a dict, in which plants and controllers of installed packages are named MODULE:NAME."""

    def resolve(reference: PluginReference) -> str:
        name = reference.reference
        if user_code.is_reference(name) or reference.kind == "observer" or name in NAMES[reference.kind]:
            return name
        plugin = find_plugins(reference.kind).get(name)
        return plugin.reference if plugin else name

    return replace_references(study, resolve)


def absolute(study: TomlTable, folder: Path | None = None) -> TomlTable:
    """Return a study, as a dict, with absolute paths; relative ones are from `folder`, by default the working folder."""
    base = Path().resolve() if folder is None else folder
    return replace_references(study, lambda r: user_code.resolve_reference(r.reference, base))
