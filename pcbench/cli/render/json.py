"""What a program reads: arrays, complex numbers and tuples as JSON."""

import json
from collections.abc import Mapping
from typing import Any


def readable(content: Any) -> str:
    """Return arrays, complex numbers and tuples as readable JSON."""

    def plain(value: Any) -> Any:
        if hasattr(value, "tolist"):
            return plain(value.tolist())
        if isinstance(value, complex):
            return {"real": value.real, "imag": value.imag}
        if isinstance(value, Mapping):
            return {str(k): plain(v) for k, v in value.items()}
        if isinstance(value, tuple | list):
            return [plain(v) for v in value]
        if isinstance(value, float) and value != value:
            return None
        if value in (float("inf"), float("-inf")):
            return str(value)
        return value

    return json.dumps(plain(content), indent=2)
