"""MATLAB files, read by scipy.io: vectors of one length; `topic` names a struct that holds them, or is left out.

A file is read as a whole, for its reader has no other way: once, however many channels and passes there are, and of its
variables only those that are asked for are held.
"""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pcbench.errors import UserError, unknown, unreadable
from pcbench.recordings.decompression import require_small_mat
from pcbench.recordings.log import Floats
from pcbench.recordings.units import SECONDS


def reader(topics: Iterable[str]) -> Callable[..., Iterator[dict[str, Floats]]]:
    """Return what reads fields of these structs of one file, which is loaded when the first is asked for."""
    names = sorted({topic.partition(".")[0] for topic in topics})
    loaded: dict[str, Any] = {}

    def fields(
        path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
    ) -> Iterator[dict[str, Floats]]:
        """Yield vectors, [K] each; times in seconds."""
        if not loaded:
            loaded.update(_variables(path, None if "" in names else names, where))
        there = loaded
        for part in filter(None, topic.split(".")):
            if not isinstance(there.get(part), dict):
                every = _variables(path, None, where) if there is loaded else there
                structs = [name for name, value in every.items() if isinstance(value, dict)]
                raise unknown(f"{where}: {path.name}", "struct", part, structs)
            there = there[part]
        out = {}
        for field in wanted:
            if field not in there:
                raise unknown(f"{where}: {path.name}", "variable", field, there)
            scale = SECONDS[unit or "s"] if field in times else 1.0
            out[field] = _numbers(there[field], f"{where}: {path.name}: {field}") * scale
        lengths = {field: v.size for field, v in out.items()}
        if len(set(lengths.values())) > 1 or any(v.ndim != 1 for v in out.values()):
            said_ = ", ".join(f"{field} {np.shape(v)}" for field, v in out.items())
            raise UserError(f"{where}: {path.name}: got {said_}, expected vectors of one length; save them so.")
        yield out

    return fields


def _numbers(value: Any, where: str) -> Floats:
    """A variable as an array of numbers."""
    found = np.asarray(value)
    if found.dtype.kind not in "fiub":
        got = {"U": "text", "c": "complex numbers"}.get(found.dtype.kind, "a struct, cells or what is sparse")
        raise UserError(f"{where}: got {got}, expected a vector of numbers; save it so.")
    return np.atleast_1d(found.astype(float))


def _variables(path: Path, names: list[str] | None, where: str) -> dict[str, Any]:
    """The variables of these names (None: all), structs as dicts."""
    from scipy.io import loadmat

    try:
        require_small_mat(path, f"{where}: {path.name}")
        there = loadmat(path, simplify_cells=True, variable_names=names)
    except UserError:
        raise
    except Exception as error:  # SciPy raises MatReadError, zlib.error and TypeError among others
        raise unreadable(error, f"{where}: {path.name}", "MATLAB's format 7 or less; save it with -v7") from None
    return {name: value for name, value in there.items() if name[:2] != "__"}
