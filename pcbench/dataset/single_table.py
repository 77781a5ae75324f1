"""One table as a file of the kind that its name says: Parquet, which keeps units and meanings, or CSV, which keeps numbers.

The blocks of a study are written by `task.compute`.
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
    """Return the suffix of a file's name; raise UserError where it is none of KINDS."""
    kind = Path(str(out)).suffix.lower()
    if kind not in KINDS:
        suffix = f"the suffix '{kind}'" if kind else "no suffix"
        raise UserError(f"--out {out}: got {suffix}, expected one of {', '.join(KINDS)}; give the file such a name.")
    return kind


def put(out: str | Path, table: pa.Table) -> None:
    """Put a table into a file, whole or not at all."""
    if kind_of(out) == ".parquet":
        storage.put_table(*_place(out), table)
    else:
        put_content(out, as_csv(table))


def as_csv(table: pa.Table) -> bytes:
    """Return a table as CSV; null is an empty field."""
    content = io.BytesIO()
    csv.write_csv(table, content, csv.WriteOptions(quoting_style="needed"))
    return content.getvalue()


def put_content(out: str | Path, content: bytes) -> None:
    """Put bytes into a file, whole or not at all; raise UserError where it cannot be written."""
    storage.put(*_place(out), content)


def _place(out: str | Path) -> tuple[storage.Target, str]:
    """The folder of a file, which is made, and its name there."""
    folder, _, name = str(out).replace("\\", "/").rpartition("/")
    target = storage.target(folder or ("/" if str(out).startswith("/") else "."))
    storage.make(target)
    return target, name


def trace_table(frame: "pd.DataFrame", signals: tuple[tuple[str, str], ...]) -> pa.Table:
    """Return a trace as a table whose columns say their unit; ticks 0 .. N, estimates after the jump of each tick."""
    units, inputs = {"t": "s"} | dict(signals), frame.attrs.get("input_units", {})
    fields = []
    for name in map(str, frame.columns):
        meaning = "time" if name == "t" else "estimate" if "." in name else "truth" if name in units else ""
        if name.endswith(".sigma"):
            meaning = "standard deviation of the error by the observer's own covariance"
        if name.startswith("target."):
            meaning = "set point"
        unit = (inputs.get(name) or "unit of the input") if name[0] == "u" else "unit of the output"
        about = {"unit": units.get(name.removesuffix(".sigma").rpartition(".")[2], unit)}
        about["meaning"] = meaning or (
            "input held over the tick" if name[0] == "u" else "newest arrived measurement, held"
        )
        for what in ("predicts_unknown_input", "certified") if "." in name else ():
            known = frame.attrs.get(what, {}).get(name.partition(".")[0])
            about |= {} if known is None else {what: str(known).lower()}
        fields.append(pa.field(name, pa.float64(), metadata=about))
    schema = pa.schema(fields, metadata={"pcbench.schema": SCHEMA})
    return pa.Table.from_pandas(frame, schema=schema, preserve_index=False)
