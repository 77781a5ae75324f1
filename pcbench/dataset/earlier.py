"""Tables of earlier releases: which are read, and what they lack. No jax."""

from collections.abc import Callable

import pyarrow as pa

from pcbench.dataset import columns

# the runs are the same in all; stats and pairs of schema 5 lack `certified`, and of both what 7 has of exact numbers
READ = ("5", "6", columns.SCHEMA)
ALWAYS = {"method": "runs"}  # what an earlier release had no word for
FLOW = "stepped"  # of a block that does not say how its observer went
Order = Callable[[list[str]], list[str]]  # axes -> the columns of a table


def is_read(metadata: dict[bytes, bytes] | None) -> bool:
    """Say whether a table with this metadata is of a schema that this release reads."""
    return (metadata or {}).get(b"pcbench.schema") in [version.encode() for version in READ]


def completed(there: pa.Table, order: Order) -> pa.Table:
    """Return a table in the order of this release; what it lacks is null: unknown, but for the method."""
    names = order(columns.axes_of(dict.fromkeys(there.column_names)))
    lacking = [name for name in names if name not in there.column_names]
    if not lacking:
        return there
    unknown = columns.table({name: [ALWAYS.get(name)] * len(there) for name in lacking})
    for name in lacking:
        there = there.append_column(unknown.field(name), unknown[name])
    return there.select(names)


def follows(there: pa.Table, made: pa.Table) -> bool:
    """Say whether a table is what comes out now, less the columns that its release lacked."""
    older = (there.schema.metadata or {}).get(b"pcbench.schema") != columns.SCHEMA.encode()
    known = [name for name in made.column_names if not older or name in there.column_names]
    return bool(there.equals(made.select(known)))
