"""User-defined observers: a `pcbench.Observer` with the functions of its module.

Their options are a pydantic model. Errors in the model are reported as one sentence with the line.
"""

import ast
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from pcbench.errors import UserError, brief_repr, describe_exception, is_ours
from pcbench.observers import OBSERVERS, ObserverSpec
from pcbench.protocols import Observer
from pcbench.study.plugins import user_code
from pcbench.study.plugins.user_code import Code, UserPlugin
from pcbench.study.pydantic_errors import user_error
from pcbench.toml_text import TomlTable

ABSENT = "its code is not loaded"


class NoOptions(BaseModel):
    """The options of an observer whose module has no `Options`."""

    model_config = ConfigDict(extra="forbid")


def entry(observer: Observer | ObserverSpec, module: ModuleType, where: str) -> ObserverSpec:
    """Return the entry of a module's object: itself, or an observer with the module's `design` and `Options`."""
    if isinstance(observer, ObserverSpec):
        return observer
    builtin = [spec for spec in OBSERVERS.values() if spec.observer is observer]
    if builtin:
        return builtin[0]
    design, options = getattr(module, "design", None), getattr(module, "Options", NoOptions)
    if not callable(design):
        raise UserError(
            f"{where}: got an Observer in a module without a function design(context, options), expected one; write it "
            "in the observer's file, or name an ObserverSpec that has it."
        )
    return ObserverSpec(observer, options, design, knows_schedule=True, summary="yours", expensive=True)


def absent(reference: str, code: Code, options: TomlTable) -> UserPlugin:
    """Return a placeholder for an observer with its options, used when a result is read without its code."""
    placeholder = user_code.absent(reference)
    fields: TomlTable = {name: (object, value) for name, value in options.items()}
    spec = ObserverSpec(
        observer=Observer(
            init=placeholder, snapshot=placeholder, jump=placeholder, flow=placeholder, estimate=placeholder
        ),
        options=create_model("Options", __config__=ConfigDict(extra="allow"), **fields),
        design=placeholder,
        knows_schedule=False,
        summary=ABSENT,
        takes="any schedule",
        nonlinear=True,
    )
    return UserPlugin(spec, code)


def is_absent(plugin: UserPlugin) -> bool:
    """Return whether the plugin is a placeholder without code."""
    return bool(plugin.entry.summary == ABSENT)


Model = TypeVar("Model", bound=BaseModel)


def require_model(options: object, module: ModuleType, where: str) -> None:
    """Raise UserError if the options of a module's object are not a pydantic model."""
    if isinstance(options, type) and issubclass(options, BaseModel):
        return
    kind = "another class" if isinstance(options, type) else brief_repr(options)
    file, name = Path(str(module.__file__)), getattr(options, "__name__", "Options")
    place = file.name
    for node in ast.parse(file.read_bytes()).body:
        names = [target.id for target in getattr(node, "targets", []) if isinstance(target, ast.Name)]
        if {name, "Options"} & {getattr(node, "name", ""), *names}:
            place = f"{file.name} line {node.lineno}"
            break
    raise UserError(
        f"{where}: got {kind} as Options, {place}, expected a pydantic model; write class Options(pydantic.BaseModel)."
    )


def validate_options(model: type[Model], table: TomlTable, where: str) -> Model:
    """Return the options of a table, validated and with defaults; raise UserError for invalid ones."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise user_error(where, error, {"": model.model_fields}) from None
    except Exception as error:  # exception in a validator
        if is_ours(model):
            raise
        raise UserError(
            f"{where}: its {model.__name__} raised {describe_exception(error)}, expected options or a ValueError; "
            "correct that line."
        ) from error
