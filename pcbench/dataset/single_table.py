"""One table as a file, Parquet with units and meanings or CSV with numbers, by the suffix of its name.

`task.compute` writes the blocks of a study.
"""

import io
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
from pyarrow import csv

from pcbench.dataset import storage
from pcbench.dataset.columns import SCHEMA
from pcbench.errors import UserError

if TYPE_CHECKING:
    import pandas as pd

KINDS = (".parquet", ".csv")


def kind_of(out: str | Path) -> str:
    """Return the suffix of a file's name; raise UserError if it is not one of KINDS."""
    kind = Path(str(out)).suffix.lower()
    if kind not in KINDS:
        suffix = f"the suffix '{kind}'" if kind else "no suffix"
        raise UserError(f"--out {out}: got {suffix}, expected one of {', '.join(KINDS)}; give the file such a name.")
    return kind


def write_table(out: str | Path, table: pa.Table) -> None:
    """Write a table to a file, completely or not at all."""
    if kind_of(out) == ".parquet":
        storage.write_table(*_place(out), table)
    else:
        put_content(out, as_csv(table))


def as_csv(table: pa.Table) -> bytes:
    """Return a table as CSV; null is an empty field."""
    content = io.BytesIO()
    csv.write_csv(table, content, csv.WriteOptions(quoting_style="needed"))
    return content.getvalue()


def put_content(out: str | Path, content: bytes) -> None:
    """Write bytes to a file, completely or not at all; raise UserError if that fails."""
    storage.write_file(*_place(out), content)


def _place(out: str | Path) -> tuple[storage.Target, str]:
    """The folder of a file, which is created, and the file's name in it."""
    folder, _, name = str(out).replace("\\", "/").rpartition("/")
    target = storage.target(folder or ("/" if str(out).startswith("/") else "."))
    storage.create_folder(target)
    return target, name


def trace_table(frame: "pd.DataFrame", signals: tuple[tuple[str, str], ...]) -> pa.Table:
    """Return a simulated run as a table with units; ticks 0 .. N, estimates after the jump of each tick."""
    units = {"t": "s"} | dict(signals)
    channels = frame.attrs.get("input_units", {}) | frame.attrs.get("output_units", {})
    fields = []
    for name in map(str, frame.columns):
        meaning = "time" if name == "t" else "estimate" if "." in name else "truth" if name in units else ""
        if name.endswith(".sigma"):
            meaning = "standard deviation of the error by the observer's own covariance"
        if name.startswith("target."):
            meaning = "set point"
        unit = channels.get(name) or f"unit of the {'input' if name[0] == 'u' else 'output'}"
        about = {"unit": units.get(name.removesuffix(".sigma").rpartition(".")[2], unit)}
        about["meaning"] = meaning or (
            "input held over the tick" if name[0] == "u" else "newest arrived measurement, held"
        )
        for key in ("predicts_unknown_input", "certified") if "." in name else ():
            value = frame.attrs.get(key, {}).get(name.partition(".")[0])
            about |= {} if value is None else {key: str(value).lower()}
        fields.append(pa.field(name, pa.float64(), metadata=about))
    schema = pa.schema(fields, metadata={"pcbench.schema": SCHEMA})
    return pa.Table.from_pandas(frame, schema=schema, preserve_index=False)
