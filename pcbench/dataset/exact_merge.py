"""The exact parts of several datasets of one study, made one: cells are numbered as in the first; what two hold must agree.

Exact numbers do not depend on seeds, so every part may have them all. Cells that shared a call with others may differ in their
last bits: more than rounding is refused.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from pcbench.dataset import manifest, moments_tables, parquet_io, storage
from pcbench.dataset.manifest import Owned
from pcbench.errors import UserError

ROUNDING, ZERO = 1e-9, 1e-11  # relative; absolute, in any unit
Moved = dict[tuple[str, int], int]  # by scenario and number in a part, the cell's number in the merged dataset
Holder = tuple[storage.Target, Owned, Moved, str]  # and the file's name there


def pieces(targets: list[storage.Target], holdings: list[Owned], whole: Owned) -> Iterator[tuple[str, pa.Table]]:
    """Yield the files of the merged exact part by name; raise UserError where one is damaged, or two parts disagree."""
    for name, holders in sorted(_holders(targets, holdings).items()):
        first, *others = holders
        table = _read(first, whole)
        for other in others:
            if not agree(table, _read(other, whole)):
                raise UserError(
                    f"{other[0].name}/{other[3]}: differs from {first[0].name}/{first[3]} by more than rounding, expected "
                    "equal numbers; run the study of one of them again with --overwrite."
                )
        yield name, table


def _holders(targets: list[storage.Target], holdings: list[Owned]) -> dict[str, list[Holder]]:
    """Return by name in the merged dataset who holds a file."""
    numbers = {(s, digest): number for (s, number), digest in manifest.digests(holdings[0]).items()}
    out: dict[str, list[Holder]] = {}
    for target, owned in zip(targets, holdings, strict=True):
        moved = {(s, n): numbers[s, digest] for (s, n), digest in manifest.digests(owned).items()}
        called = {moments_tables.place(s, n): moments_tables.place(s, to) for (s, n), to in moved.items()}
        called[moments_tables.NAME] = moments_tables.NAME
        for name in filter(called.__contains__, storage.names(target)):
            out.setdefault(called[name], []).append((target, owned, moved, name))
    return out


def _read(holder: Holder, whole: Owned) -> pa.Table:
    """Return the rows of a file as the merged dataset is to hold them."""
    target, owned, moved, name = holder
    content = storage.get(target, name)
    table = None if content is None else parquet_io.whole(content)
    if table is None:
        raise UserError(f"{target.name}/{name}: is damaged, expected a whole file; run its study again first.")
    if name != moments_tables.NAME:
        return table
    about: dict[Any, Any] = dict(table.schema.metadata or {})
    stands = about.pop(moments_tables.OF, b"") == moments_tables.of(owned)  # else the next run makes it anew
    about |= {moments_tables.OF: moments_tables.of(whole)} if stands else {}
    return parquet_io.sealed(_numbered(table, moved, whole).replace_schema_metadata(about))


def _numbered(table: pa.Table, moved: Moved, whole: Owned) -> pa.Table:
    """Return exact rows with their cells numbered, and in the order, of the merged dataset."""
    keys = list(zip(table["scenario"].to_pylist(), table["cell"].to_pylist(), strict=True))
    numbers = [moved[key] for key in keys]
    turn = {cell.key: i for i, cell in enumerate(whole.cells)}
    after = [turn[scenario, number] for (scenario, _), number in zip(keys, numbers, strict=True)]
    at = table.schema.get_field_index("cell")
    table = table.set_column(at, table.schema.field(at), pa.array(numbers, table.schema.field(at).type))
    return table.take(sorted(range(len(table)), key=after.__getitem__))


def agree(a: pa.Table, b: pa.Table) -> bool:
    """Return whether two tables hold the same but for rounding."""
    if a.schema.names != b.schema.names or len(a) != len(b):
        return False
    for x, y in zip(a.columns, b.columns, strict=True):
        if x.equals(y):
            continue
        if not pa.types.is_floating(x.type) or x.null_count != y.null_count:
            return False
        if not np.allclose(x.to_numpy(), y.to_numpy(), ROUNDING, ZERO, equal_nan=True):
            return False
    return True
