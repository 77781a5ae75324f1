"""User-defined objects of a study, by kind: the entry that MODULE:NAME refers to.

An observer, a plant, a controller or a scenario is the attribute NAME of a module. Installed packages offer theirs by entry
points, of the group `pcbench.observers` and similar ones. Only modules that are named are imported.
"""

from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from pcbench import controllers, observers, plants
from pcbench.errors import UserError, unknown
from pcbench.protocols import Controller, Observer
from pcbench.signal_names import pair
from pcbench.study.plugins import user_code, user_controllers, user_observers
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.plugins.user_observers import require_model
from pcbench.toml_text import TomlTable

ELSEWHERE = "bc1bc4dc4132"  # digest of code that pcbench does not run: pcbench's files do not affect external results
DICT = "a dict with the keys of a table [scenario]"


Entry = observers.ObserverSpec | plants.PlantSpec | controllers.ControllerSpec | TomlTable


class Kind(NamedTuple):
    """A kind of plugin."""

    types: tuple[type, ...]  # allowed types of the object in a module
    expected: str  # as text
    entry: Callable[..., Entry]  # (object, module, place) -> its entry


class InModule(NamedTuple):
    """In a scenario's table: an object of the scenario's own module."""

    name: str


def _plant(spec: plants.PlantSpec, module: ModuleType, where: str) -> plants.PlantSpec:
    for name, unit in spec.signals + spec.unknowns + spec.errors + spec.outputs:
        pair(name, unit, f"{where}: {name}")
    return spec


def _table(table: TomlTable, module: ModuleType, where: str) -> TomlTable:
    """Return a scenario's table in which a plant or a controller of its module is replaced by its name."""
    out = dict(table)
    for kind in ("plant", "controller"):
        value = out.get(kind)
        if kind not in out or isinstance(value, str):
            continue
        names = [name for name, v in vars(module).items() if v is value]
        if not isinstance(value, KINDS[kind].types) or not names:
            raise UserError(
                f"{where}.{kind}: got {describe_kind(value)}, expected {KINDS[kind].expected} from the same module, or a "
                "name; write one of them."
            )
        out[kind] = InModule(names[0])
    return out


KINDS = {
    "observer": Kind(
        (Observer, observers.ObserverSpec), "a pcbench.Observer, or a pcbench.ObserverSpec", user_observers.entry
    ),
    "plant": Kind((plants.PlantSpec,), "what pcbench.make_plant returns", _plant),
    "controller": Kind(
        (Controller, controllers.ControllerSpec),
        "a pcbench.Controller, or a pcbench.ControllerSpec",
        user_controllers.entry,
    ),
    "scenario": Kind((dict,), DICT, _table),
}


class PackagePlugin(NamedTuple):
    """A plugin of an installed package."""

    reference: str  # MODULE:NAME
    package: str


def find_plugins(kind: str) -> dict[str, PackagePlugin]:
    """Return the plugins of installed packages of a kind, by name; nothing is imported."""
    points = entry_points(group=f"pcbench.{kind}s")
    return {point.name: PackagePlugin(point.value, point.dist.name if point.dist else "") for point in points}


def load(kind: str, reference: str, where: str, folder: Path | None = None) -> UserPlugin:
    """Return the plugin MODULE:NAME; paths are relative to `folder` (default: the working folder).

    Raises UserError if it does not exist, if its module raises, or if it is of another kind.
    """
    code = user_code.code_of(reference, where, folder)
    module, _ = user_code.split(reference, where)
    code_folder = ((folder or Path()) / module).resolve().parent if code.files else None
    return plugin_of(kind, code, where, code_folder)


def plugin_of(kind: str, code: user_code.Code, where: str, folder: Path | None = None) -> UserPlugin:
    """Return the plugin of some code; raise UserError if it has none, or a plant or a controller with a built-in name."""
    module = user_code.module_of(code, where, folder)
    member, names = user_code.attribute_of(module, code.name, KINDS[kind].types)
    if member is None:
        raise unknown(f"{where} {code.module}", f"{kind} there", code.name, names)
    if not isinstance(member, KINDS[kind].types):
        raise UserError(f"{where}: got {describe_kind(member)}, expected {KINDS[kind].expected}; name one of those.")
    builtin: dict[str, Iterable[str]] = {"plant": plants.PLANTS, "controller": controllers.CONTROLLERS}
    if code.name in builtin.get(kind, ()):
        raise UserError(
            f"{where}: got a {kind} called '{code.name}', which is pcbench's own name; give it another name."
        )
    entry = KINDS[kind].entry(member, module, where)
    if isinstance(entry, observers.ObserverSpec | controllers.ControllerSpec):
        require_model(entry.options, module, where)
    elsewhere = not code.files and getattr(entry, "elsewhere", False)
    return UserPlugin(entry, code._replace(digest=ELSEWHERE if elsewhere else user_code.digest_of(code, module)))


def describe_kind(member: object) -> str:
    """Return a short description of an object's type."""
    if isinstance(member, plants.PlantSpec):
        return "a plant"
    if isinstance(member, observers.ObserverSpec | Observer):
        return "an observer"
    if isinstance(member, controllers.ControllerSpec | Controller):
        return "a controller"
    return "a function" if callable(member) and not isinstance(member, type) else f"a {type(member).__name__}"
