"""Times of a log in seconds: what unit a column is in, as its head or a TOML says."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pcbench.errors import UserError, unknown
from pcbench.recordings import columns

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
LATEST = 1e11  # [s] what is said to be seconds is below it: the year 5138
HEAD = re.compile(r"^\s*(.*?)\s*(?:\[(.*)\])?\s*$")


def parts(head: str) -> tuple[str, str | None]:
    """Return the name and the unit of a column's head, such as "sampled [ms]"; None where it has none."""
    found = HEAD.match(head)
    return (found[1], found[2]) if found else (head, None)


def seconds(column: pa.ChunkedArray | pa.Array, unit: str | None, where: str) -> NDArray[np.float64]:
    """Return a column of times in seconds, NaN where it is empty; raise UserError where its unit is unknown or must be said."""
    if unit is not None and unit not in SECONDS:
        raise unknown(where, "unit of time", unit, SECONDS)
    if pa.types.is_timestamp(column.type):
        column, unit = pc.cast(pc.cast(column, pa.timestamp("ns")), pa.int64()), "ns"
    plain = columns.numbers(column, where)
    if unit is None and plain.size and np.nanmax(np.abs(plain), initial=0.0) > LATEST:
        raise UserError(
            f"{where}: got {np.nanmax(np.abs(plain)):.4g} without a unit, expected seconds; write the unit into the column's "
            "head, such as 'sampled [ns]', or time_unit in a TOML."
        )
    return plain * SECONDS[unit or "s"]
