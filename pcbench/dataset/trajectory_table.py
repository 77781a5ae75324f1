"""A trace as a table that other programs read: every column says its unit and what it is. No jax."""

import pandas as pd
import pyarrow as pa

from pcbench.dataset.columns import SCHEMA


def trace_table(frame: pd.DataFrame, signals: tuple[tuple[str, str], ...]) -> pa.Table:
    """Return a trace as a table whose columns say their unit; ticks 0 .. N, estimates after the jump of each tick."""
    units, driven = {"t": "s"} | dict(signals), frame.attrs.get("input_units", {})
    fields = []
    for name in frame.columns:
        plain = (driven.get(name) or "unit of the input") if name[0] == "u" else "unit of the output"
        unit = units.get(name.removesuffix(".sigma").rpartition(".")[2], plain)
        meaning = "time" if name == "t" else "estimate" if "." in name else "truth" if name in units else ""
        meaning = (
            "standard deviation that the observer believes its error to have" if name.endswith(".sigma") else meaning
        )
        meaning = "set point" if name.startswith("target.") else meaning
        meaning = meaning or ("input held over the tick" if name[0] == "u" else "newest arrived measurement, held")
        about = {"unit": unit, "meaning": meaning}
        for what in ("predicts_unknown_input", "certified") if "." in name else ():
            known = frame.attrs.get(what, {}).get(name.partition(".")[0])
            about |= {} if known is None else {what: str(known).lower()}
        fields.append(pa.field(name, pa.float64(), metadata=about))
    schema = pa.schema(fields, metadata={"pcbench.schema": SCHEMA})
    return pa.Table.from_pandas(frame, schema=schema, preserve_index=False)
