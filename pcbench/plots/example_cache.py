"""Tables that figures need in addition to those of a study, computed once and stored in `examples` next to the results."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pyarrow as pa

from pcbench.dataset import parquet_io, storage
from pcbench.runtime import provenance
from pcbench.study.grid import Cell
from pcbench.study.plugins.user_observers import is_absent

KEY = b"pcbench.example"  # the key in a file's metadata: what it was made of


class CacheEntry(NamedTuple):
    """A stored table of a cell, its observers and this release; `about` are further parts of its key."""

    name: str
    cell: Cell
    about: Sequence[object]

    @property
    def path(self) -> str:
        """Return its file below the dataset's folder."""
        return f"examples/{self.name.replace('/', '%2F')}.parquet"

    @property
    def key(self) -> bytes:
        """Return what it was made of."""
        options = {label: o.model_dump() for label, o in self.cell.options.items()}
        content = [self.cell.digest, options, self.cell.options_digests, provenance.versions(), *self.about]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest().encode()

    @property
    def is_computable(self) -> bool:
        """Whether the code of every observer, plant and law of a user's own is here."""
        return not any(map(is_absent, [*self.cell.user_observers.values(), *self.cell.scenario.user_code.values()]))


def load_table(out: str | Path | None, entry: CacheEntry) -> pd.DataFrame | None:
    """Return the entry of `out` with this key; None if there is none or it has another type."""
    content = None if out is None else storage.read_buffer(storage.target(str(out)), entry.path)
    table = None if content is None else parquet_io.unseal_table(content)
    return table.to_pandas() if table is not None and table.schema.metadata.get(KEY) == entry.key else None


def store(out: str | Path | None, entry: CacheEntry, frame: pd.DataFrame) -> pd.DataFrame:
    """Store the table of an entry in `out`, if there is such a folder, and return it."""
    if out is not None:
        table = pa.Table.from_pandas(frame, preserve_index=False)
        metadata = {**(table.schema.metadata or {}), KEY: entry.key}
        storage.write_table(
            storage.target(str(out)), entry.path, parquet_io.seal_table(table.replace_schema_metadata(metadata))
        )
    return frame
