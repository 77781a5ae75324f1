"""MATLAB files, read by scipy.io: vectors of one length; `topic` names a struct that holds them, or is left out."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pcbench.errors import UserError, unknown, unreadable
from pcbench.logs.log import Floats
from pcbench.logs.units import SECONDS


def fields(
    path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
) -> Iterator[dict[str, Floats]]:
    """Yield vectors, [K] each; times in seconds."""
    from scipy.io import loadmat

    try:
        there: dict[str, Any] = {k: v for k, v in loadmat(path, simplify_cells=True).items() if k[:2] != "__"}
    except Exception as error:  # SciPy raises MatReadError, zlib.error and TypeError among others
        raise unreadable(error, f"{where}: {path.name}", "MATLAB's format 7 or less; save it with -v7") from None
    for part in filter(None, topic.split(".")):
        if not isinstance(there.get(part), dict):
            raise unknown(f"{where}: {path.name}", "struct", part, [k for k, v in there.items() if isinstance(v, dict)])
        there = there[part]
    out = {}
    for field in wanted:
        if field not in there:
            raise unknown(f"{where}: {path.name}", "variable", field, there)
        scale = SECONDS[unit or "s"] if field in times else 1.0
        out[field] = np.atleast_1d(np.asarray(there[field], float)) * scale
    lengths = {field: v.size for field, v in out.items()}
    if len(set(lengths.values())) > 1 or any(v.ndim != 1 for v in out.values()):
        said_ = ", ".join(f"{field} {np.shape(v)}" for field, v in out.items())
        raise UserError(f"{where}: {path.name}: got {said_}, expected vectors of one length; save them so.")
    yield out
