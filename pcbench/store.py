"""What a run leaves on disk, whole or not at all. No jax.

A file is written beside its place, synced and renamed; an interrupted run leaves complete files only. A folder belongs to
one study: the study's own text in it is what says so.
"""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq

from pcbench.errors import UserError

PARTIAL = ".partial"
CLOSING = ("stats.parquet", "pairs.parquet", "provenance.json")  # written last: they say that a run is whole


def claim(out: Path, study: str) -> None:
    """Make the folder this study's own by putting `study.toml` there; refuse one that holds anything else."""
    mine = out / "study.toml"
    try:
        if mine.is_file():
            if mine.read_text(encoding="utf-8") != study and any(out.rglob("*.parquet")):
                raise UserError(f"{out}: holds the results of another study; give a new folder with --out.")
        elif out.exists() and (not out.is_dir() or any(p for p in out.iterdir() if not p.name.endswith(PARTIAL))):
            raise UserError(f"{out}: holds other files, expected a new or empty folder; give another one with --out.")
        for left in [*out.rglob(f"*{PARTIAL}"), *(out / name for name in CLOSING)]:
            left.unlink(missing_ok=True)
    except OSError as error:
        raise _cannot(out, error) from None
    write(mine, lambda path: path.write_text(study, encoding="utf-8"))


def write(path: Path, fill: Callable[[Path], Any]) -> None:
    """Let `fill` write a file beside `path`, sync it and rename it; leave nothing behind where that fails."""
    beside = path.with_name(f".{path.name}{PARTIAL}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fill(beside)
        with open(beside, "rb+") as f:
            os.fsync(f.fileno())
        os.replace(beside, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise _cannot(path, error) from None
    finally:
        with _ignored():
            beside.unlink(missing_ok=True)


def write_table(path: Path, table: pa.Table) -> None:
    """Write one Parquet file, whole."""
    write(path, lambda beside: pq.write_table(table, beside, compression="zstd"))


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write one JSON file, whole."""
    write(path, lambda beside: beside.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8"))


def runs_path(out: Path, scenario: str, observer: str, cell: int) -> Path:
    """Return the place of the runs of one observer in one cell: a hive-partitioned dataset."""
    folder = out / "runs" / f"scenario={quote(scenario, safe='')}" / f"observer={quote(observer, safe='')}"
    return folder / f"cell-{cell:05d}.parquet"


def complete_files(out: Path) -> int:
    """Return how many finished tables a folder holds."""
    return sum(1 for _ in out.rglob("*.parquet"))


def _cannot(path: Path, error: OSError) -> UserError:
    reason = error.strerror or str(error)
    return UserError(
        f"{path}: cannot be written ({reason}); expected a folder with room that you may write to; give another with --out."
    )


def _sync_folder(folder: Path) -> None:
    with _ignored():  # not every file system lets a folder be opened
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def _ignored() -> Iterator[None]:
    try:
        yield
    except OSError:
        return
