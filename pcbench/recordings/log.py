"""A recording (log): measurements with arrival times, inputs, and truth if known; and its sources.

Measurements are rows (channel, sampled [s], arrived [s], value), inputs and truth rows (t [s], values). A log is read in parts
and can be read repeatedly, so it may be larger than memory. Rows may be in any order. One pass (`survey`) finds how far behind
the newest timestamp a row may come. Times are seconds of the log's own clock.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError, unreadable
from pcbench.recordings.csv_dialects import CSV_DEFAULTS, CsvOptions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Columns = dict[str, Floats]  # fields of a file by name, [K] each, times in seconds
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
MOST = 2000  # largest number of examined fields of a topic
NO_TIME = " of times (write sampled = NAME, or period = SECONDS if the file has none)"  # part of a message on a field


class Batch(NamedTuple):
    """K samples, in the order of the log."""

    channel: Ints  # [K] index of the channel
    sampled: Floats  # [K] s
    arrived: Floats  # [K] s; NaN: did not arrive
    value: Floats  # [K]
    row: Ints  # [K] row of its table or message of its topic, from 1
    std: Floats = np.zeros(0)  # [K] standard deviation of the noise, NaN: not stated; [0]: stated for none

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Batch":
        """Return some of the samples, by a mask or by indices."""
        std = self.std[rows] if len(self.std) else self.std
        return Batch(self.channel[rows], self.sampled[rows], self.arrived[rows], self.value[rows], self.row[rows], std)


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
    """A log that can be read repeatedly."""

    name: str  # as in messages
    channels: tuple[str, ...]
    measurements: Callable[[], Iterator[Batch]]
    inputs: Table | None = None
    truth: Table | None = None
    units: tuple[str, ...] = ()  # of the channels; empty: those of the plant


class Source(NamedTuple):
    """Fields of one topic in a file. The module of a format has `columns`, which yields them in parts."""

    path: Path
    topic: str
    fields: list[str]
    times: set[str]  # the fields that are times
    unit: str | None  # of times that are numbers; None: the default of the format
    where: str  # place of the request, for messages
    topics: set[str]  # all topics requested from this file
    cache: dict[str, Any]  # data of the file that sources share
    csv: CsvOptions = CSV_DEFAULTS
    frame: str = ""  # child frame of the requested transforms, in messages with several
    default_stamp: bool = False  # the timestamp field is a default: a message without it has its receive time

    @property
    def place(self) -> str:
        """The request and the file, for messages."""
        return self.where if self.where == self.path.name else f"{self.where}: {self.path.name}"


class Topic(NamedTuple):
    """A topic of a file. The module of a format has `topics`, which yields them."""

    name: str
    kind: str
    numbers: list[str]
    times: Sequence[str] = ()  # fields with a time type, the first one the timestamp
    frame: str = ""
    words: Sequence[str] = ()  # fields of text
    problem: str = ""  # reason why some of its fields are left out


def shift_stamps(log: Log, offsets: Floats) -> Log:
    """Return a log with `offsets` [q] s added to the timestamps of its channels; arrival times are unchanged."""

    def measurements() -> Iterator[Batch]:
        return (b._replace(sampled=b.sampled + offsets[b.channel]) for b in log.measurements())

    return log._replace(measurements=measurements)


@contextmanager
def convert_errors(source: Source, expected: str) -> Iterator[None]:
    """Convert any exception of a library on a damaged file into a UserError with what was `expected`."""
    try:
        yield
    except (UserError, ImportError):
        raise
    except Exception as error:  # libraries raise struct.error, zlib.error, TypeError and their own errors
        raise unreadable(error, source.place, expected) from None


def require_topic(topic: str, topics: Iterable[str], where: str) -> None:
    """Raise UserError for a topic that a file does not have."""
    names = sorted(topics)
    if topic not in names:
        got = f"the topic '{topic}'" if topic else "no topic"
        raise UserError(f"{where}: got {got}, expected one of {', '.join(names) or 'none: it is empty'}; write that.")
