"""MATLAB files, read by scipy.io: vectors of one length; `topic` names a struct that holds them, or is left out.

A file is read as a whole, for its reader has no other way: once, however many channels and passes there are, and of its
variables only those that are asked for are held.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from pcbench.errors import UserError, unknown
from pcbench.recordings.decompression import require_small_mat
from pcbench.recordings.log import SECONDS, Columns, Source, reading


def columns(source: Source) -> Iterator[Columns]:
    """Yield vectors, times in seconds."""
    if not source.loaded:
        names = sorted({topic.partition(".")[0] for topic in source.topics})
        source.loaded.update(_variables(source, None if "" in names else names))
    struct = source.loaded
    for part in filter(None, source.topic.split(".")):
        if not isinstance(struct.get(part), dict):
            every = _variables(source, None) if struct is source.loaded else struct
            raise unknown(source.place, "struct", part, [name for name, v in every.items() if isinstance(v, dict)])
        struct = struct[part]
    out = {}
    for field in source.fields:
        if field not in struct:
            raise unknown(source.place, "variable", field, struct)
        value = np.asarray(struct[field])
        if value.dtype.kind not in "fiub":
            got = {"U": "text", "c": "complex numbers"}.get(value.dtype.kind, "a struct, cells or what is sparse")
            raise UserError(f"{source.place}: {field}: got {got}, expected a vector of numbers; save it so.")
        scale = SECONDS[source.unit or "s"] if field in source.times else 1.0
        out[field] = np.atleast_1d(value.astype(float)) * scale
    if len({v.size for v in out.values()}) > 1 or any(v.ndim != 1 for v in out.values()):
        shapes = ", ".join(f"{field} {v.shape}" for field, v in out.items())
        raise UserError(f"{source.place}: got {shapes}, expected vectors of one length; save them so.")
    yield out


def _variables(source: Source, names: list[str] | None) -> dict[str, Any]:
    """The variables of these names (None: all), structs as dicts."""
    from scipy.io import loadmat

    with reading(source, "MATLAB's format 7 or less; save it with -v7"):
        require_small_mat(source.path, source.place)
        variables = loadmat(source.path, simplify_cells=True, variable_names=names)
    return {name: value for name, value in variables.items() if name[:2] != "__"}
