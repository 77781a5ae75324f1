"""Observers of a user's own in a study, by label: what MODULE:NAME names, as an entry beside pcbench's."""

from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, create_model

from pcbench.errors import UserError, unknown
from pcbench.observers import OBSERVERS, Entry
from pcbench.protocols import Observer
from pcbench.study import own
from pcbench.synthesis.certificate import Design, Setting

ABSENT = "its code is not here"
GROUP = "pcbench.observers"  # entry points by which an installed package offers observers


class NoOptions(BaseModel):
    """The options of an observer whose module has no `Options`."""

    model_config = ConfigDict(extra="forbid")


class OwnObserver(NamedTuple):
    """An observer of a user's own, and the code that makes it."""

    entry: Entry
    code: own.Code


def installed() -> dict[str, str]:
    """Return the observers that installed packages offer: MODULE:NAME by name; nothing is imported."""
    return {point.name: point.value for point in entry_points(group=GROUP)}


def load(reference: str, where: str, folder: Path | None = None) -> OwnObserver:
    """Return the observer that MODULE:NAME names; raise UserError where there is none."""
    code = own.code_of(reference, where, folder)
    module, _ = own.split(reference, where)
    here = ((folder or Path()) / module).resolve().parent if code.files else None
    return of(code, where, here)


def of(code: own.Code, where: str, folder: Path | None = None) -> OwnObserver:
    """Return the observer that some code makes; raise UserError where it makes none."""
    module = own.module_of(code, where, folder)
    found, there = own.found_in(module, code.name, (Observer, Entry))
    if found is None:
        raise unknown(f"{where} {code.module}", "observer there", code.name, there)
    return OwnObserver(entry(found, module, where), code._replace(digest=own.digest_of(code, module)))


def entry(found: Any, module: Any, where: str) -> Entry:
    """Return the entry of what a module holds: itself, or an observer with the module's `design` and `Options`."""
    if isinstance(found, Entry):
        return found
    if not isinstance(found, Observer):
        raise UserError(
            f"{where}: got {_kind(found)}, expected a pcbench.Observer, or an Entry of pcbench.observers; name one of those."
        )
    listed = [each for each in OBSERVERS.values() if each.observer is found]
    if listed:
        return listed[0]
    design, options = getattr(module, "design", None), getattr(module, "Options", NoOptions)
    if not callable(design):
        raise UserError(
            f"{where}: got an Observer in a module without a function design(setting, options), expected one; write it beside "
            "the observer, or name an Entry that has it."
        )
    return Entry(observer=found, options=options, design=design, knows_schedule=True, summary="yours")


def named(label: str, reference: str, where: str) -> OwnObserver:
    """Return the observer that a study's table `use` names."""
    return load(reference, where)


def absent(label: str, reference: str, options: dict[str, Any]) -> OwnObserver:
    """Return what stands for an observer where its code is not asked for, with the options it had: a result is read so."""

    def design(setting: Setting, options: Any) -> Design:
        raise UserError(
            f"{label}: got no code of {reference}, expected it where runs are made; run the study that names it."
        )

    def nothing(*given: Any) -> Any:
        return design(*given)

    kept: dict[str, Any] = {name: (Any, value) for name, value in options.items()}
    stand_in = Entry(
        observer=Observer(init=nothing, note=nothing, jump=nothing, flow=nothing, estimate=nothing),
        options=create_model("Options", __config__=ConfigDict(extra="allow"), **kept),
        design=design,
        knows_schedule=False,
        summary=ABSENT,
        takes="any schedule",
        nonlinear=True,
    )
    module, name = own.split(reference, label)
    parts = module.split("/") if module.startswith(f"{own.FOLDER}/") else ["", "", module]
    return OwnObserver(stand_in, own.Code(parts[-1], name, (), parts[1]))


def is_absent(mine: OwnObserver) -> bool:
    """Say whether an observer stands there without its code."""
    return mine.entry.summary == ABSENT


def _kind(found: Any) -> str:
    return "a function" if callable(found) and not isinstance(found, type) else f"a {type(found).__name__}"
