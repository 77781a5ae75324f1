"""One table as a file of the kind that its name says: Parquet, which keeps units and meanings, or CSV, which keeps numbers."""

import io
from pathlib import Path

import pyarrow as pa
from pyarrow import csv

from pcbench.dataset import storage
from pcbench.errors import UserError

KINDS = (".parquet", ".csv")


def kind_of(out: str | Path) -> str:
    """Return the suffix of a file's name; raise UserError where it is none of KINDS."""
    kind = Path(str(out)).suffix.lower()
    if kind not in KINDS:
        found = f"the suffix '{kind}'" if kind else "no suffix"
        raise UserError(f"--out {out}: got {found}, expected one of {', '.join(KINDS)}; give the file such a name.")
    return kind


def put(out: str | Path, table: pa.Table) -> None:
    """Put a table into a file, whole or not at all."""
    if kind_of(out) == ".parquet":
        target, name = _place(out)
        storage.put_table(target, name, table)
        return
    put_content(out, as_csv(table))


def as_csv(table: pa.Table) -> bytes:
    """Return a table as CSV; null is an empty field."""
    content = io.BytesIO()
    csv.write_csv(table, content, csv.WriteOptions(quoting_style="needed"))
    return content.getvalue()


def put_content(out: str | Path, content: bytes) -> None:
    """Put bytes into a file, whole or not at all; raise UserError where it cannot be written."""
    target, name = _place(out)
    storage.put(target, name, content)


def _place(out: str | Path) -> tuple[storage.Target, str]:
    """The folder of a file, which is made, and its name there."""
    folder, _, name = str(out).replace("\\", "/").rpartition("/")
    target = storage.target(folder or ("/" if str(out).startswith("/") else "."))
    storage.make(target)
    return target, name
