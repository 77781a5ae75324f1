"""What an option of an observer says of itself besides its type and bounds."""

from typing import Any

import numpy as np
from pydantic import Field
from pydantic.fields import FieldInfo

from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError

TUNABLE, WAY = "tunable", "way"  # keys in a field's extra


def tunable(default: Any, between: tuple[float, float] | None = None, **how: Any) -> Any:
    """Return a field as pydantic's `Field` does, of an option that may be tuned: gains depend on it smoothly.

    `between` are the numbers within which it lies, where both bound it. With gt=0 or ge=0 alone it stays positive.
    """
    return Field(default, json_schema_extra={TUNABLE: list(between or ())}, **how)


def way(default: Any, **how: Any) -> Any:
    """Return a field of an option that says in which way gains are found: what `pcbench design --gain` sets."""
    return Field(default, json_schema_extra={WAY: True}, **how)


def extra(field: FieldInfo) -> dict[str, Any]:
    """Return what an option says of itself besides its type."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


def matrix(given: float | list[list[float]], shape: tuple[int, int], where: str, what: str) -> Matrix:
    """Return a gain that was given as a matrix; raise UserError where it is of another shape than `shape`, of `what`."""
    try:
        found = np.full((1, 1), given) if isinstance(given, float) else np.array(given, float)
    except ValueError:
        found = np.zeros(0)
    if found.shape != shape:
        raise UserError(f"{where}: got {given}, expected a matrix of shape {list(shape)}: {what}.")
    return found
