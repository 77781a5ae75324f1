"""What is in a log as a table, a row a channel."""

from pathlib import Path
from typing import TYPE_CHECKING

from pcbench.recordings import readers
from pcbench.recordings.survey import described, survey

if TYPE_CHECKING:
    import pandas as pd


def info(name: str | Path, *, delay: float | None = None) -> "pd.DataFrame":
    """Return what is in a log, a row a channel: rate, gaps and delays [s], samples out of order or doubled, stamps that drift.

    `name` is a folder or file of tables, or a TOML that says what of a bag is which channel; `delay` [s] stands for arrivals
    that it does not have. `log(...).attrs["survey"]` has what the picture `plots.delays` shows. Raises UserError with the row.
    """
    import pandas as pd

    found = survey(readers.opened(name, delay))
    table = pd.DataFrame(described(found))
    table.attrs = {"survey": found, "name": str(name)}
    return table
