"""The options of a user's own code: a pydantic model, filled; what it is or raises instead is one sentence with its line."""

import ast
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pcbench.errors import UserError, is_ours, raised, shown
from pcbench.study.pydantic_errors import sentence

Model = TypeVar("Model", bound=BaseModel)


def require_model(options: Any, module: ModuleType, where: str) -> None:
    """Raise UserError where the options of what a module holds are no pydantic model."""
    if isinstance(options, type) and issubclass(options, BaseModel):
        return
    kind = "another class" if isinstance(options, type) else shown(options)
    raise UserError(
        f"{where}: got {kind} as Options, {_place(options, module)}, expected a pydantic model; write "
        "class Options(pydantic.BaseModel)."
    )


def filled(model: type[Model], given: dict[str, Any], where: str) -> Model:
    """Return the options that a table gives, checked and complete; raise UserError for what does not fit."""
    try:
        return model.model_validate(given)
    except ValidationError as error:
        raise sentence(where, error, {"": model.model_fields}) from None
    except Exception as error:  # of a validator
        if is_ours(model):
            raise
        raise UserError(
            f"{where}: its {model.__name__} raised {raised(error)}, expected options or a ValueError; mend that line."
        ) from error


def _place(options: Any, module: ModuleType) -> str:
    """Where a module has its options: `file line n`."""
    file = Path(str(module.__file__))
    name = getattr(options, "__name__", "Options")
    for node in ast.parse(file.read_bytes()).body:
        names = [target.id for target in getattr(node, "targets", []) if isinstance(target, ast.Name)]
        if {name, "Options"} & {getattr(node, "name", ""), *names}:
            return f"{file.name} line {node.lineno}"
    return file.name
