"""Observers of a user's own: a `pcbench.Observer` with the functions of its module, as an entry beside pcbench's."""

from typing import Any

from pydantic import BaseModel, ConfigDict, create_model

from pcbench.errors import UserError
from pcbench.observers import OBSERVERS, ObserverSpec
from pcbench.protocols import Observer
from pcbench.study.plugins.user_code import Code, Own
from pcbench.synthesis.certificate import Design, DesignContext

ABSENT = "its code is not here"


class NoOptions(BaseModel):
    """The options of an observer whose module has no `Options`."""

    model_config = ConfigDict(extra="forbid")


def entry(found: Any, module: Any, where: str) -> ObserverSpec:
    """Return the entry of what a module holds: itself, or an observer with the module's `design` and `Options`."""
    if isinstance(found, ObserverSpec):
        return found
    listed = [each for each in OBSERVERS.values() if each.observer is found]
    if listed:
        return listed[0]
    design, options = getattr(module, "design", None), getattr(module, "Options", NoOptions)
    if not callable(design):
        raise UserError(
            f"{where}: got an Observer in a module without a function design(setting, options), expected one; write it beside "
            "the observer, or name an Entry that has it."
        )
    return ObserverSpec(found, options, design, knows_schedule=True, summary="yours", expensive=True)


def absent(reference: str, code: Code, options: dict[str, Any]) -> Own:
    """Return what stands for an observer where its code is not asked for, with the options it had: a result is read so."""

    def design(setting: DesignContext, options: Any) -> Design:
        raise UserError(f"{reference}: got no code, expected it where runs are made; run the study that names it.")

    def nothing(*given: Any) -> Any:
        return design(*given)

    kept: dict[str, Any] = {name: (Any, value) for name, value in options.items()}
    stand_in = ObserverSpec(
        observer=Observer(init=nothing, snapshot=nothing, jump=nothing, flow=nothing, estimate=nothing),
        options=create_model("Options", __config__=ConfigDict(extra="allow"), **kept),
        design=design,
        knows_schedule=False,
        summary=ABSENT,
        takes="any schedule",
        nonlinear=True,
    )
    return Own(stand_in, code)


def is_absent(mine: Own) -> bool:
    """Say whether something stands there without its code."""
    return bool(mine.entry.summary == ABSENT)
