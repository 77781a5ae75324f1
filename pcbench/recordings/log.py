"""A log: what was measured and when it arrived, what was put in, and where it is known what was true; and its sources.

Measurements are rows (channel, sampled [s], arrived [s], value), inputs and truth rows (t [s], values). A log is read a part
at a time, as often as it is asked for, so it may be longer than memory. Rows may be in any order: how far behind the newest
stamp one may come is found by reading it once (`survey`). Times are seconds of the log's own clock.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError, unreadable
from pcbench.recordings.csv_dialects import FOUND, CsvOptions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Columns = dict[str, Floats]  # fields of a file by their names, [K] each, times in seconds
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
MOST = 2000  # fields of a topic that are looked at
NO_TIME = " of times (write sampled = NAME, or period = SECONDS if the file has none)"  # in a sentence on a field


class Batch(NamedTuple):
    """K samples, in the order in which they stand in the log."""

    channel: Ints  # [K] which of the log's channels
    sampled: Floats  # [K] s
    arrived: Floats  # [K] s; NaN: it never arrived
    value: Floats  # [K]
    row: Ints  # [K] where it stands: the row of its table or the message of its topic, from 1
    std: Floats = np.zeros(0)  # [K] standard deviation of the value's noise, NaN: none is stated; [0]: of no value

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Batch":
        """Return some of the samples: those that are true, or those at these places."""
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
    """A log that can be read, again and again."""

    name: str  # as a sentence names it
    channels: tuple[str, ...]
    measurements: Callable[[], Iterator[Batch]]
    inputs: Table | None = None
    truth: Table | None = None
    units: tuple[str, ...] = ()  # of the channels; empty: those of the plant


class Source(NamedTuple):
    """Fields of one topic, and where they are. A module of a format has `columns`, which yields them a part at a time."""

    path: Path
    topic: str
    fields: list[str]
    times: set[str]  # those of the fields that are times
    unit: str | None  # of times that are plain numbers; None: as the format has it
    where: str  # as a sentence names what asks for them
    topics: set[str]  # all that will be asked for of this file
    loaded: dict[str, Any]  # what the first source of a log has read or checked, for all of them
    csv: CsvOptions = FOUND
    frame: str = ""  # of messages that hold transforms: the child frame of those that are meant
    defaulted: bool = False  # the field of stamps is nobody's choice: a message without it counts when it was received

    @property
    def place(self) -> str:
        """What asks and the file, as a sentence names them."""
        return self.where if self.where == self.path.name else f"{self.where}: {self.path.name}"


class Topic(NamedTuple):
    """What a file has under one name. A module of a format has `topics`, which yields them."""

    name: str
    kind: str
    numbers: list[str]
    times: Sequence[str] = ()  # fields that are times by their type, the first one the stamp
    frame: str = ""
    words: Sequence[str] = ()  # fields of text
    problem: str = ""  # why some of its fields are left out


def shift_stamps(log: Log, offsets: Floats) -> Log:
    """Return a log with `offsets` [q] s added to the stamps of its channels; arrivals stay as they are."""

    def measurements() -> Iterator[Batch]:
        return (b._replace(sampled=b.sampled + offsets[b.channel]) for b in log.measurements())

    return log._replace(measurements=measurements)


@contextmanager
def reading(source: Source, expected: str) -> Iterator[None]:
    """Turn whatever a library raises of a damaged file into a UserError that says what was `expected`."""
    try:
        yield
    except (UserError, ImportError):
        raise
    except Exception as error:  # libraries raise struct.error, zlib.error, TypeError and what is their own
        raise unreadable(error, source.place, expected) from None


def require_topic(topic: str, existing: Iterable[str], where: str) -> None:
    """Raise UserError for a topic that a file does not have."""
    names = sorted(existing)
    if topic not in names:
        got = f"the topic '{topic}'" if topic else "no topic"
        raise UserError(f"{where}: got {got}, expected one of {', '.join(names) or 'none: it is empty'}; write that.")
