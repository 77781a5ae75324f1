"""Corrections of a recording by a TOML: timestamps, units, origin, held values; and a TOML with corrected timestamps.

    value = scale * recorded value + offset,   timestamp = recorded one + clock_offset,   arrival = timestamp + delay

A table of measurements needs no mapping of fields to channels, but has the same keys for corrections:

    log = "flight"                      # a folder or file of tables
    [channels.y1]                       # other channels, inputs and states are unchanged
    clock_offset = -0.135               # [s]
    scale = 1000.0
    offset = -4500.0                    # such as minus the operating point
    only_changes = true                 # a repeated value is not a measurement
    delay = 0.2                         # [s], for a table without the column arrived: required for all channels
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


class ValueCorrection(BaseModel):
    """Correction of an input or a state."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    scale: float = 1.0
    offset: float = 0.0


class ChannelCorrection(ValueCorrection):
    """Correction of a channel."""

    clock_offset: float = 0.0
    only_changes: bool = False
    delay: float | None = Field(None, ge=0)


class TablesToml(BaseModel):
    """All of a TOML that corrects tables."""

    model_config = ConfigDict(extra="forbid")
    log: str
    channels: dict[str, ChannelCorrection] = {}
    inputs: dict[str, ValueCorrection] = {}
    truth: dict[str, ValueCorrection] = {}


class Changes:
    """Detect changes of a channel's value, in parts."""

    def __init__(self) -> None:
        self.last: Floats = np.full(1, np.nan)

    def __call__(self, values: Floats) -> NDArray[np.bool_]:
        """Return where values differ from the previous one, also across parts."""
        is_change = np.diff(values, prepend=self.last) != 0
        self.last = values[-1:] if len(values) else self.last
        return np.asarray(is_change)


def correct_tables(log: Log, toml: TablesToml, where: str, has_delay: bool) -> Log:
    """Return tables with corrections; `has_delay`: samples arrive a delay after their timestamp, required for each channel.

    Raises UserError for a name that the tables do not have.
    """
    for section, names in (("channels", log.channels), ("inputs", _names(log.inputs)), ("truth", _names(log.truth))):
        for name in getattr(toml, section):
            if name not in names:
                raise unknown(f"{where}: {section}", "name", name, names)
    corrections = [toml.channels.get(name, ChannelCorrection()) for name in log.channels]
    for name, c in zip(log.channels, corrections, strict=True):
        if (c.delay is None) == has_delay:
            got = "no delay and a table without arrivals" if has_delay else "a delay and a table with arrivals"
            raise UserError(f"{where}: channels.{name}: got {got}, expected one of them; correct this channel.")
    keys = ("scale", "offset", "clock_offset")
    scale, offset, clock = (np.array([getattr(c, key) for c in corrections]) for key in keys)
    delay = np.array([c.delay or 0.0 for c in corrections])

    def measurements() -> Iterator[Batch]:
        changes = [Changes() for _ in corrections]
        for b in log.measurements():
            stamps = b.sampled + clock[b.channel]
            b = b._replace(
                sampled=stamps,
                arrived=stamps + delay[b.channel] if has_delay else b.arrived,
                value=scale[b.channel] * b.value + offset[b.channel],
                std=np.abs(scale[b.channel]) * b.std if len(b.std) else b.std,
            )
            mask = np.ones(len(b.row), bool)
            for i, c in enumerate(corrections):
                if c.only_changes:
                    of_channel = b.channel == i
                    mask[of_channel] = changes[i](b.value[of_channel])
            yield b.select(mask)

    return log._replace(
        measurements=measurements, inputs=_correct(log.inputs, toml.inputs), truth=_correct(log.truth, toml.truth)
    )


def _names(table: Table | None) -> tuple[str, ...]:
    return table.names if table else ()


def _correct(table: Table | None, corrections: Mapping[str, ValueCorrection]) -> Table | None:
    if table is None or not corrections:
        return table
    by_column = [corrections.get(name, ValueCorrection()) for name in table.names]
    scale, offset = np.array([c.scale for c in by_column]), np.array([c.offset for c in by_column])

    def read() -> Iterator[Rows]:
        return (rows._replace(values=scale * rows.values + offset) for rows in table.read())

    return Table(table.names, read)


def toml_with_offsets(log: Path, offsets: Mapping[str, float], delay: float | None, folder: Path) -> str:
    """Return a TOML in `folder` of a recording with `offsets` [s] added to the timestamps of its channels.

    Arrival times stay the same. If they follow from a delay, of the TOML or the common `delay` [s], the delay is increased as
    much as timestamps are moved back.
    """
    is_toml = log.suffix.lower() == ".toml"
    raw: TomlTable = toml_text.parse(log.read_bytes()) if is_toml else {"log": "."}
    file = log.parent / raw["log"] if is_toml else log
    raw["log"] = Path(os.path.relpath(file.absolute(), folder.absolute())).as_posix()
    channels: TomlTable = raw.setdefault("channels", {})
    for name, offset in offsets.items():
        table: TomlTable = channels.setdefault(name, {})
        table["clock_offset"] = table.get("clock_offset", 0.0) + offset
        late = table.get("delay", delay)
        if late is not None and "arrived" not in table:
            table["delay"] = max(late - offset, 0.0)
    return tomli_w.dumps(raw)
