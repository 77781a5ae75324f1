"""What a TOML corrects of a recording: stamps, units, an origin, values that are only held; and a TOML with corrected stamps.

    value = scale * what the recording has + offset,   stamp = what it has + clock_offset,   arrival = stamp + delay

A table of measurements has no fields that a TOML maps to channels, but it is corrected in the same words:

    log = "flight"                      # a folder or file of tables
    [channels.y1]                       # channels, inputs and states that are not named stay as they are
    clock_offset = -0.135               # [s]
    scale = 1000.0
    offset = -4500.0                    # such as minus the operating point
    only_changes = true                 # a value that equals the one before it is not a measurement
    delay = 0.2                         # [s], of a table without the column arrived: all channels need one
    [inputs.u1]                         # scale and offset
    [truth.level]
"""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pcbench import toml_text
from pcbench.errors import UserError, unknown
from pcbench.recordings.log import Batch, Floats, Log, Rows, Table
from pcbench.toml_text import TomlTable


class Values(BaseModel):
    """Correction of an input or a state."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    scale: float = 1.0
    offset: float = 0.0


class Samples(Values):
    """Correction of a channel."""

    clock_offset: float = 0.0
    only_changes: bool = False
    delay: float | None = Field(None, ge=0)


class TablesToml(BaseModel):
    """All of a TOML that corrects tables."""

    model_config = ConfigDict(extra="forbid")
    log: str
    channels: dict[str, Samples] = {}
    inputs: dict[str, Values] = {}
    truth: dict[str, Values] = {}


class Changes:
    """Which values of a channel differ from the one before, a part at a time."""

    def __init__(self) -> None:
        self.last: Floats = np.full(1, np.nan)

    def __call__(self, values: Floats) -> NDArray[np.bool_]:
        """Return where values differ from the one before, which may be of an earlier part."""
        changed = np.diff(values, prepend=self.last) != 0
        self.last = values[-1:] if len(values) else self.last
        return np.asarray(changed)


def correct_tables(log: Log, toml: TablesToml, where: str, late: bool) -> Log:
    """Return tables with corrections; `late`: samples arrive a delay after their stamp, which each channel has.

    Raises UserError for a name that the tables do not have.
    """
    for what, names in (("channels", log.channels), ("inputs", _names(log.inputs)), ("truth", _names(log.truth))):
        for name in getattr(toml, what):
            if name not in names:
                raise unknown(f"{where}: {what}", "name", name, names)
    each = [toml.channels.get(name, Samples()) for name in log.channels]
    for name, c in zip(log.channels, each, strict=True):
        if (c.delay is None) == late:
            got = "no delay and a table without arrivals" if late else "a delay and a table with arrivals"
            raise UserError(f"{where}: channels.{name}: got {got}, expected one of them; correct this channel.")
    scale, offset, clock = (np.array([getattr(c, key) for c in each]) for key in ("scale", "offset", "clock_offset"))
    delay = np.array([c.delay or 0.0 for c in each])

    def measurements() -> Iterator[Batch]:
        changes = [Changes() for _ in each]
        for b in log.measurements():
            stamps = b.sampled + clock[b.channel]
            b = b._replace(
                sampled=stamps,
                arrived=stamps + delay[b.channel] if late else b.arrived,
                value=scale[b.channel] * b.value + offset[b.channel],
                std=np.abs(scale[b.channel]) * b.std if len(b.std) else b.std,
            )
            kept = np.ones(len(b.row), bool)
            for i, c in enumerate(each):
                if c.only_changes:
                    mine = b.channel == i
                    kept[mine] = changes[i](b.value[mine])
            yield b.select(kept)

    return log._replace(
        measurements=measurements, inputs=_corrected(log.inputs, toml.inputs), truth=_corrected(log.truth, toml.truth)
    )


def _names(table: Table | None) -> tuple[str, ...]:
    return table.names if table else ()


def _corrected(table: Table | None, given: Mapping[str, Values]) -> Table | None:
    if table is None or not given:
        return table
    each = [given.get(name, Values()) for name in table.names]
    scale, offset = np.array([c.scale for c in each]), np.array([c.offset for c in each])

    def read() -> Iterator[Rows]:
        return (rows._replace(values=scale * rows.values + offset) for rows in table.read())

    return Table(table.names, read)


def toml_with_offsets(log: Path, offsets: Mapping[str, float], delay: float | None, folder: Path) -> str:
    """Return a TOML in `folder` of a recording with `offsets` [s] added to the stamps of its channels.

    Arrivals stay as they are: where they follow from a delay, of the TOML or all samples' `delay` [s], it is longer by as much
    as stamps are earlier.
    """
    is_toml = log.suffix.lower() == ".toml"
    raw: TomlTable = toml_text.parse(log.read_bytes()) if is_toml else {"log": "."}
    file = log.parent / raw["log"] if is_toml else log
    raw["log"] = Path(os.path.relpath(file.absolute(), folder.absolute())).as_posix()
    channels: TomlTable = raw.setdefault("channels", {})
    for name, offset in offsets.items():
        mine: TomlTable = channels.setdefault(name, {})
        mine["clock_offset"] = mine.get("clock_offset", 0.0) + offset
        late = mine.get("delay", delay)
        if late is not None and "arrived" not in mine:
            mine["delay"] = max(late - offset, 0.0)
    return tomli_w.dumps(raw)
