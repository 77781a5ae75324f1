"""CSV and Parquet of any shape: a column for each channel, or a file with one row a sample; fields are columns."""

from collections.abc import Iterator
from pathlib import Path

from pcbench.recordings import columns, units
from pcbench.recordings.log import Floats


def fields(
    path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
) -> Iterator[dict[str, Floats]]:
    """Yield parts of columns, [K] each; times in seconds. What is empty is NaN."""
    columns.require(path, columns.heads(path), wanted, f"{where}: {path.name}")
    for part in columns.parts(path, wanted):
        found = {}
        for name in wanted:
            column = part.column(name)
            if name in times:
                found[name] = units.seconds(column, unit or units.parts(name)[1], f"{where}: {name}")
            else:
                found[name] = columns.numbers(column, f"{where}: {name}")
        yield found
