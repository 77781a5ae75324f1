"""Values as JSON has them: objects, lists, numbers, text, true, false and null."""

import math
from collections.abc import Mapping
from typing import Any


def json_values(value: Any, nulls: bool = True) -> Any:
    """Return arrays, tuples, complex numbers and mappings as JSON values.

    NaN becomes null and an infinity becomes text, because JSON has neither. Without `nulls`, entries of mappings that are null
    are left out, because TOML has no null.
    """
    if hasattr(value, "tolist"):  # of NumPy, which is not imported here
        value = value.tolist()
    if isinstance(value, Mapping):
        entries = {str(key): json_values(entry, nulls) for key, entry in value.items()}
        return {key: entry for key, entry in entries.items() if nulls or entry is not None}
    if isinstance(value, tuple | list):
        return [json_values(entry, nulls) for entry in value]
    if isinstance(value, complex):
        return {"real": value.real, "imag": value.imag}
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value
