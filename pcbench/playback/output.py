"""What a replay leaves in a folder: estimates tick by tick, written as they come, and what is known of each observer."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pcbench.dataset import atomic_files, local_files, storage
from pcbench.dataset.columns import SCHEMA
from pcbench.errors import UserError
from pcbench.runtime import ending

ESTIMATES = "estimates.parquet"
SUMMARY = "replay.json"


def fields(observers: dict[str, list[tuple[str, str]]], start: float, dt: float) -> pa.Schema:
    """Return the columns of estimates: t and <observer>.<signal>, given (signal, unit) of each observer."""
    about = {"unit": "s", "meaning": "time since the start of the log"}
    out = [pa.field("t", pa.float64(), metadata=about)]
    for observer, signals in observers.items():
        for signal, unit in signals:
            said = {"unit": unit, "meaning": "estimate, after the jump of the tick"}
            out.append(pa.field(f"{observer}.{signal}", pa.float64(), metadata=said))
    return pa.schema(out, metadata={"pcbench.schema": SCHEMA, "start": repr(start), "dt": repr(dt)})


class Draft(NamedTuple):
    """A replay's files before they have their names."""

    folder: Path
    estimates: Path  # the file, which can be read once it is closed
    write: Callable[[pa.Table], None]  # some ticks more
    close: Callable[[], None]


@contextmanager
def draft(folder: Path) -> Iterator[Draft]:
    """Make a replay's files beside their names: `finish` gives them these, and what was stopped before leaves nothing."""
    writers: list[Any] = []  # of the table, and of the file under it
    part, new = folder / f".{ESTIMATES}.part", not folder.exists()

    def write(found: pa.Table) -> None:
        if not writers:
            part.unlink(missing_ok=True)  # of a process that was killed
            sink = os.fdopen(local_files.create(part), "wb")
            writers.extend([pq.ParquetWriter(sink, found.schema, compression="snappy", use_dictionary=False), sink])
        writers[0].write_table(found, row_group_size=len(found))

    def close() -> None:
        while writers:
            writers.pop(0).close()

    def clear() -> None:
        for each in (part, _summary(part)):
            with suppress(OSError):
                each.unlink(missing_ok=True)
        if new:
            with suppress(OSError):  # it holds the files that were made
                folder.rmdir()

    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with ending.cleaned(clear):
                yield Draft(folder, part, write, close)
        finally:
            close()
    except OSError as error:
        raise UserError(f"--out {folder}: {error.strerror}, expected a folder to write to; give another.") from None
    finally:
        clear()


def finish(d: Draft, summary: dict[str, Any]) -> None:
    """Write what else is known beside the estimates, NaN as null, and give both files their names."""
    storage.put_json(storage.target(d.folder), _summary(d.estimates).name, plain(summary))
    atomic_files.renamed([(d.estimates, d.folder / ESTIMATES), (_summary(d.estimates), d.folder / SUMMARY)])


def _summary(part: Path) -> Path:
    return part.with_name(f".{SUMMARY}.part")


def table(schema: pa.Schema, t: np.ndarray, estimates: list[np.ndarray]) -> pa.Table:
    """Return some ticks of estimates [K, n] of each observer as a table."""
    columns = [t, *(each[:, i] for each in estimates for i in range(each.shape[1]))]
    return pa.Table.from_arrays([pa.array(np.ascontiguousarray(c)) for c in columns], schema=schema)


def parts(file: Path) -> Iterator[tuple[int, pa.Table]]:
    """Yield the estimates of a file part by part, with the tick at which each begins."""
    first = 0
    with pq.ParquetFile(file) as there:
        for i in range(there.num_row_groups):
            found = there.read_row_group(i, use_threads=False)
            yield first, found
            first += len(found)


def plain(thing: Any) -> Any:
    """Return a summary as JSON has it."""
    if isinstance(thing, dict):
        return {str(key): plain(each) for key, each in thing.items()}
    if isinstance(thing, list | tuple):
        return [plain(each) for each in thing]
    number = thing.item() if isinstance(thing, np.generic) else thing
    return None if isinstance(number, float) and not np.isfinite(number) else number
