"""What pictures need besides the tables: made once, kept in the folder `examples` beside these, and found again there."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from pcbench.dataset import parquet, store
from pcbench.machine import provenance
from pcbench.study.cells import Cell
from pcbench.study.own_observers import is_absent

KEY = b"pcbench.example"  # the key in a file's metadata: what it was made of


def kept(
    out: str | Path | None, name: str, cell: Cell, about: list[Any], make: Callable[[], pd.DataFrame]
) -> pd.DataFrame | None:
    """Return what stands in `out` below a name, of this cell, its observers and this release, and what is said `about` it.

    Made where it does not stand there; None where it does not and the code of an observer of a user's own is not here.
    """
    target, path = None if out is None else store.target(str(out)), f"examples/{name.replace('/', '%2F')}.parquet"
    key = _key(cell, about)
    found = None if target is None else store.get(target, path)
    there = None if found is None else parquet.whole(found)
    if there is not None and there.schema.metadata.get(KEY) == key:
        return there.to_pandas()
    if any(map(is_absent, [*cell.own.values(), *cell.scenario.own.values()])):
        return None
    made = make()
    if target is not None:
        table = pa.Table.from_pandas(made, preserve_index=False)
        said = {**(table.schema.metadata or {}), KEY: key}
        store.put_table(target, path, parquet.sealed(table.replace_schema_metadata(said)))
    return made


def _key(cell: Cell, about: list[Any]) -> bytes:
    options = {o: given.model_dump() for o, given in cell.options.items()}
    said = [cell.digest, options, cell.told, provenance.versions(), *about]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest().encode()
