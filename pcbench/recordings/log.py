"""A log: what was measured and when it arrived, what was put in, and where it is known what was true.

Measurements are rows (channel, sampled [s], arrived [s], value), inputs and truth rows (t [s], values). A log is read a part
at a time, as often as it is asked for, so it may be longer than memory. Rows may stand in any order: how far behind the newest
stamp one may come is found by reading it once (`survey`). Times are seconds of the log's own clock.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.recordings.clocks import HOUR, apart

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Batch(NamedTuple):
    """K samples, in the order in which they stand in the log."""

    channel: Ints  # [K] which of the log's channels
    sampled: Floats  # [K] s
    arrived: Floats  # [K] s; NaN: it never arrived
    value: Floats  # [K]
    row: Ints  # [K] where it stands: the row of its table or the message of its topic, from 1


class Rows(NamedTuple):
    """K rows of inputs or truth."""

    t: Floats  # [K] s
    values: Floats  # [K, columns]
    row: Ints  # [K]


class Table(NamedTuple):
    """A table of inputs or truth."""

    names: tuple[str, ...]
    read: Callable[[], Iterator[Rows]]


class Log(NamedTuple):
    """A log that can be read, again and again."""

    name: str  # as a sentence names it
    channels: tuple[str, ...]
    measurements: Callable[[], Iterator[Batch]]
    inputs: Table | None = None
    truth: Table | None = None


def require_sound(log: Log, batch: Batch) -> None:
    """Raise UserError naming the first row of a batch that no run can be fed with.

    Such is one without a number or a time, or that arrived before it was sampled.
    """
    for bad, got, expected in (
        (~np.isfinite(batch.sampled), "a sample without a time", "the second at which it was taken in 'sampled'"),
        (~np.isfinite(batch.value) & ~np.isnan(batch.arrived), "the value {value}", "a finite number"),
        (batch.arrived < batch.sampled, "a sample that arrived {early:.6g} s before it was sampled", "no such row"),
    ):
        if bad.any():
            i = int(np.argmax(bad))
            early = batch.sampled[i] - batch.arrived[i]
            place = f"{log.name}: row {batch.row[i]} of channel {log.channels[batch.channel[i]]}"
            if early > HOUR:
                raise UserError(
                    f"{place}: the stamp {batch.sampled[i]:.10g} s is {apart(early)} after the arrival "
                    f"{batch.arrived[i]:.10g} s, so they are of two clocks or units; convert the arrivals to the clock of the "
                    "stamps, or leave them out and give a delay."
                )
            raise UserError(
                f"{place}: got {got.format(value=batch.value[i], early=early)}, expected {expected}; mend or leave out that "
                "row."
            )


def require_forward(where: str, before: float, rows: Rows) -> None:
    """Raise UserError naming the first row of a table of inputs or truth whose time is none, or not after the row before."""
    back = ~(np.diff(rows.t, prepend=before) > 0)
    if back.any():
        i = int(np.argmax(back))
        earlier = rows.t[i - 1] if i else before
        raise UserError(
            f"{where}: row {rows.row[i]}: got the time {rows.t[i]:.9g} s after {earlier:.9g} s, expected later times; "
            "sort the rows, and leave doubled ones out."
        )
