"""MATLAB files: vectors of equal length, columns of matrices and fields of structs; read by SciPy, format 7.3 by h5py.

`topic` names a struct, or is omitted. A field may be inside a struct (`signals.values`) or one of the signals of a matrix, from
0 (`dat.2`). Signals are the columns of a matrix, or its rows if these are longer. The readers can only read a file as a whole.
It is read once for all channels and passes, and only requested variables are kept. In format 7.3, links to other files are not
followed.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from pcbench.errors import UserError, unknown
from pcbench.recordings.decompression import require_small, require_small_mat
from pcbench.recordings.log import MOST, NO_TIME, SECONDS, Columns, Source, Topic, convert_errors

if TYPE_CHECKING:
    import h5py

HDF5 = b"\x89HDF\r\n\x1a\n"  # first bytes of such a file (format 7.3), at byte 0 or 512
DEEPEST = 32  # largest nesting of structs
KINDS = {"U": "text", "S": "text", "c": "complex numbers"}


def columns(source: Source) -> Iterator[Columns]:
    """Yield vectors, times in seconds."""
    if not source.cache:
        names = {topic.partition(".")[0] for topic in source.topics}
        source.cache.update(variables(source, None if "" in names else sorted(names)))
    struct: Any = source.cache
    for part in filter(None, source.topic.split(".")):
        if not isinstance(struct.get(part), dict):
            available = variables(source, None) if struct is source.cache else struct
            raise unknown(source.place, "struct", part, [name for name, v in available.items() if isinstance(v, dict)])
        struct = struct[part]
    out = {}
    for field in source.fields:
        value = np.asarray(_within(struct, field, source))
        if value.dtype.kind not in "fiub":
            got = KINDS.get(value.dtype.kind, "a struct, cells or what is sparse")
            raise UserError(
                f"{source.place}: {field}: got {got}, expected a vector of numbers; save it so (of a timeseries: its "
                "Time and Data)."
            )
        scale = SECONDS[source.unit or "s"] if field in source.times else 1.0
        out[field] = np.atleast_1d(value.astype(float)) * scale
    if len({v.size for v in out.values()}) > 1 or any(v.ndim != 1 for v in out.values()):
        shapes = ", ".join(f"{field} {v.shape}" for field, v in out.items())
        raise UserError(
            f"{source.place}: got {shapes}, expected vectors of one length; save them so, or name a column of a matrix, such "
            f"as {source.fields[0]}.0."
        )
    yield out


def signals_of(matrix: np.ndarray) -> list[np.ndarray]:
    """Return the signals of a matrix: its columns, or its rows if these are longer."""
    return list(matrix if matrix.shape[0] < matrix.shape[1] else matrix.T)


def topics(source: Source) -> Iterator[Topic]:
    """Yield the structs, and the variables outside structs; of each the vectors of numbers with the most common length."""

    def vectors(struct: Any, prefix: str) -> Iterator[tuple[str, int]]:
        for name, value in struct.items() if isinstance(struct, dict) else enumerate(struct):
            if isinstance(value, dict | list):
                yield from vectors(value, f"{prefix}{name}.")
            elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and 1 <= value.ndim <= 2:
                many = min(value.shape) if value.ndim == 2 else 0
                yield from ((f"{prefix}{name}{f'.{i}' if many else ''}", max(value.shape)) for i in range(many or 1))

    all_variables = variables(source, None)
    structs = {name: value for name, value in all_variables.items() if isinstance(value, dict)}
    for topic, struct in {"": {k: v for k, v in all_variables.items() if k not in structs}, **structs}.items():
        sizes = dict(islice(vectors(struct, ""), MOST))
        length = Counter(sizes.values()).most_common(1)
        if length:
            yield Topic(
                topic, "struct" if topic else "variables", [n for n, size in sizes.items() if size == length[0][0]]
            )


def _within(struct: Any, field: str, source: Source) -> Any:
    """Return the value of a dotted name in structs, lists of structs and matrices."""
    value = struct
    for part in field.split("."):
        if isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiub":
            value = signals_of(value)
        inner = value if isinstance(value, dict) else {}
        if isinstance(value, list):
            inner = {str(i): entry for i, entry in enumerate(value)}
        if part not in inner:
            time = NO_TIME if field in source.times else ""
            raise unknown(source.place, f"variable{time}", field if inner is struct else part, inner or struct)
        value = inner[part]
    return value


def variables(source: Source, names: list[str] | None) -> dict[str, Any]:
    """Return the variables of these names (None: all), structs as dicts."""
    from scipy.io import loadmat

    with convert_errors(source, "a complete MATLAB file; save it again with -v7"):
        with source.path.open("rb") as file:
            head = file.read(520)
        if HDF5 in (head[:8], head[512:]):
            import h5py

            with h5py.File(source.path, "r") as hdf:
                return _group(source, hdf, names, [0], DEEPEST)
        require_small_mat(source.path, source.place)
        contents = loadmat(source.path, simplify_cells=True, variable_names=names)
    return {name: value for name, value in contents.items() if name[:2] != "__"}


def _group(
    source: Source, group: "h5py.Group", names: list[str] | None, total: list[int], deepest: int
) -> dict[str, Any]:
    """Return the contents of a MATLAB group in HDF5; `total` counts the bytes read so far."""
    import h5py

    out: dict[str, Any] = {}
    for name in group:
        is_requested = (names is None or name in names) and name[:1] != "#" and deepest
        value = group[name] if is_requested and isinstance(group.get(name, getlink=True), h5py.HardLink) else None
        if isinstance(value, h5py.Group):
            out[name] = _group(source, value, None, total, deepest - 1)
        elif isinstance(value, h5py.Dataset) and not value.external and not value.is_virtual:
            total[0] += value.nbytes
            require_small(total[0], source.path.stat().st_size, source.place)
            is_text = value.attrs.get("MATLAB_class") == b"char"
            out[name] = "text" if is_text else np.squeeze(np.asarray(value).T)
    return out
