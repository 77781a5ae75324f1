"""Inputs and truth as one table each, merged from several topics in order of time.

An input without a value in a row is held, and is 0 before its first value. A state without a value in a row is NaN.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pcbench.errors import UserError
from pcbench.recordings.formulas import Quantity
from pcbench.recordings.log import Columns, Floats, Ints, Rows, Table
from pcbench.recordings.times import require_forward

if TYPE_CHECKING:
    import pandas as pd

Times = Callable[[Columns, Ints], Floats]  # (columns of a part, row numbers from 1) -> times


def table_of(
    columns: Callable[[], Iterator[Columns]], times: Times, quantities: Mapping[str, Quantity], where: str
) -> Table:
    """Return the table of the quantities in `columns`; rows without any value are left out."""

    def read() -> Iterator[Rows]:
        row, before = 1, -np.inf
        evaluators = [quantity.evaluator() for quantity in quantities.values()]
        for part in columns():
            values = np.stack([evaluate(part) for evaluate in evaluators], 1)
            rows = np.arange(row, row + len(values), dtype=np.int64)
            row += len(values)
            if (infinite := np.isinf(values)).any():
                i, j = (int(place[0]) for place in np.nonzero(infinite))
                raise UserError(
                    f"{where}: row {rows[i]}: got {values[i, j]} as {list(quantities)[j]}, expected a finite number; correct "
                    "it or leave it empty."
                )
            exists = ~np.isnan(values).all(1)
            chunk = Rows(times(part, rows)[exists], values[exists], rows[exists])
            if len(chunk.t):
                require_forward(where, before, chunk)
                before = float(chunk.t[-1])
                yield chunk

    return Table(tuple(quantities), read)


def merge(tables: Sequence[Table], order: Sequence[str], hold: bool) -> Table:
    """Return several tables merged, with columns in this `order`; missing values are held or NaN."""

    def read() -> Iterator[Rows]:
        import pandas as pd

        carry = pd.Series(0.0, list(order))
        for rows in _in_order([_frames(table) for table in tables]):
            by_time = rows.groupby(level=0).last()  # of several rows at one time, the last value
            values = by_time.reindex(columns=list(order))
            if hold:
                values = values.ffill().fillna(carry)
                carry = values.iloc[-1]
            yield Rows(by_time.index.to_numpy(), values.to_numpy(float), by_time["row"].to_numpy(int))

    return Table(tuple(order), read)


def _frames(table: Table) -> Iterator["pd.DataFrame"]:
    import pandas as pd

    for rows in table.read():
        yield pd.DataFrame(rows.values, rows.t, list(table.names)).assign(row=rows.row)


def _in_order(readers: list[Iterator["pd.DataFrame"]]) -> Iterator["pd.DataFrame"]:
    """Yield rows of several tables, each with increasing times, merged in order of time."""
    import pandas as pd

    pending = [next(reader, None) for reader in readers]
    while unread := [frame for frame in pending if frame is not None]:
        until = min(frame.index[-1] for frame in unread)
        yield pd.concat([frame[frame.index <= until] for frame in unread])
        for i, frame in enumerate(pending):
            if frame is not None:
                tail = frame[frame.index > until]
                pending[i] = tail if len(tail) else next(readers[i], None)
