"""A user's observer, found by MODULE:OBSERVER.

MODULE is a name that can be imported, from the working folder too, or the path of a .py file. OBSERVER is an attribute of it:
an `Entry`, or an `Observer` whose module has its `design` and, where it takes any, its `Options`. What the user's module prints
is the user's; what it raises comes back as one sentence.
"""

import difflib
import importlib
import importlib.util
import pkgutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, ValidationError

from pcbench.errors import UserError, raised, short, unknown
from pcbench.observers import OBSERVERS, Entry
from pcbench.protocols import Observer

WHERE = "check"


class Candidate(NamedTuple):
    """An observer with the name it goes by and its options."""

    label: str
    entry: Entry
    options: Any


class NoOptions(BaseModel):
    """The options of an observer whose module has no `Options`."""

    model_config = ConfigDict(extra="forbid")


def load(target: str, given: dict[str, Any] | None = None) -> Candidate:
    """Return the observer that MODULE:OBSERVER names, with the options `given`; raise UserError where there is none."""
    place, colon, name = target.rpartition(":")
    if not colon or not place or not name:
        raise UserError(
            f"{WHERE}: got '{short(target)}', expected MODULE:OBSERVER such as mine.py:nudge; name the module, or its file, "
            "and the observer in it."
        )
    module = _module(place)
    try:
        found = getattr(module, name)
    except AttributeError:
        there = [n for n, v in vars(module).items() if isinstance(v, Observer | Entry)]
        public = [n for n in vars(module) if not n.startswith("_")]
        raise unknown(f"{WHERE} {place}", "observer there", name, there or public) from None
    entry = _entry(found, module, f"{WHERE} {short(target)}")
    return Candidate(name, entry, _options(entry, given or {}, f"{WHERE} {short(target)}"))


def _entry(found: Any, module: ModuleType, where: str) -> Entry:
    if isinstance(found, Entry):
        return found
    if not isinstance(found, Observer):
        raise UserError(
            f"{where}: got {_kind(found)}, expected a pcbench.Observer, or an Entry of pcbench.observers; name one of those."
        )
    listed = [entry for entry in OBSERVERS.values() if entry.observer is found]
    if listed:
        return listed[0]
    design, options = getattr(module, "design", None), getattr(module, "Options", NoOptions)
    if not callable(design):
        raise UserError(
            f"{where}: got an Observer in a module without a function design(setting, options), expected one; write it beside "
            "the observer, or name an Entry that has it."
        )
    return Entry(found, options, design, True, "yours")


def _options(entry: Entry, given: dict[str, Any], where: str) -> Any:
    named = {key.replace("-", "_"): value for key, value in given.items()}
    fields = getattr(entry.options, "model_fields", {})
    for key in named:
        if key not in fields:
            raise unknown(where, "option", key, fields)
    try:
        return entry.options(**named)
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(
            f"{where}: option {'.'.join(map(str, first['loc'])) or 'of Options'}: {first['msg']}; give it with "
            "--set OPTION=VALUE, or write a default."
        ) from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise UserError(f"{where}: its options cannot be made: {raised(error)}; mend that.") from None


def _module(place: str) -> ModuleType:
    as_file = place.endswith(".py") or "/" in place
    if not as_file:
        return _imported(place)
    path = Path(place)
    if not path.is_file():
        near = difflib.get_close_matches(path.name, _files(path.parent), n=1, cutoff=0.4)
        hint = f"did you mean '{path.parent / near[0]}'? " if near else ""
        raise UserError(f"{WHERE}: '{short(place)}' is no file; {hint}give the path of a .py file, or a module's name.")
    sys.path.insert(0, str(path.resolve().parent))
    return _run(lambda: _executed(path), place)


def _executed(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise UserError(f"{WHERE}: got '{short(str(path))}', expected a Python file; name one that ends in .py.")
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(path.stem, module)  # options find their types by it
    spec.loader.exec_module(module)
    return module


def _imported(name: str) -> ModuleType:
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    return _run(lambda: importlib.import_module(name), name)


def _run(make: Any, place: str) -> ModuleType:
    """Import a user's module; whatever it raises becomes one sentence."""
    try:
        module: ModuleType = make()
        return module
    except UserError:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        missing = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if missing and (place + ".").startswith(missing + "."):
            near = difflib.get_close_matches(missing, _modules(missing), n=1, cutoff=0.6)
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise UserError(
                f"{WHERE}: there is no module '{short(missing)}' here; {hint}Give a module's name or the path of a .py file."
            ) from None
        raise UserError(f"{WHERE}: {short(place)} cannot be imported: {raised(error)}; mend that line.") from None


def _modules(missing: str) -> list[str]:
    """Return the modules beside a missing one, by their full names."""
    package, _, _ = missing.rpartition(".")
    folders = list(getattr(sys.modules.get(package), "__path__", [])) if package else None
    return [f"{package}.{m.name}".lstrip(".") for m in pkgutil.iter_modules(folders)]


def _files(folder: Path) -> list[str]:
    return [path.name for path in folder.glob("*.py")] if folder.is_dir() else []


def _kind(found: Any) -> str:
    return "a function" if callable(found) and not isinstance(found, type) else f"a {type(found).__name__}"
