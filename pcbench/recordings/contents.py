"""The contents of a file before channels are mapped: topics with fields, rates and ranges; and a starter TOML.

A field is *constant* if all its numbers are equal. It *repeats* if a row has the number of the row before. The timestamps are
the first field with a time type (a header's, timestamp_sample). Otherwise they are a column called t, time or stamp, preferably
an increasing one, or else the first column if it increases. If a column of times does not increase, is partly empty or contains
text, a sentence reports this.
"""

import json
import os
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcbench.errors import UserError
from pcbench.recordings import matlab, mcap, readers, rosbag, tables, ulog
from pcbench.recordings.log import SECONDS, Floats, Source, Topic
from pcbench.recordings.running_stats import RunningStats, add
from pcbench.signal_names import LONGEST_UNIT, UNIT

TOPICS = {readers.BAG: rosbag.topics, readers.MCAP: mcap.topics, readers.TABLE: tables.topics}
TOPICS |= {readers.FORMATS[".ulg"]: ulog.topics, readers.FORMATS[".mat"]: matlab.topics}
TIME = re.compile(r"(t|time|stamp|timestamp|sampled|x_value|seconds_elapsed)\b", re.IGNORECASE)
INPUT = re.compile(r"(u\d*|.*(input|cmd|command|control|motor|throttle|actuator|voltage|setpoint).*)", re.IGNORECASE)
COUNTER = re.compile(r".*(seq|count|index|time|stamp|came|arrived|received)", re.IGNORECASE)
ARRIVAL = re.compile(r"(t_|time_)?(arriv|receiv|recv)", re.IGNORECASE)
ACTIVE = 8  # largest number of active channels in a starter TOML; further ones are comments
EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # a timestamp this large counts from 1970 in this unit


class FieldStats(NamedTuple):
    """Statistics of the numbers of one field."""

    spread: RunningStats = RunningStats()
    rows: int = 0
    repeats: int = 0  # rows that repeat the number of the row before
    falls: int = 0  # rows with a number not above that of the row before
    last: float = np.nan

    @property
    def constant(self) -> bool:
        """Whether all its numbers are equal."""
        return self.spread.many > 1 and self.spread.least == self.spread.most


class TopicContents(NamedTuple):
    """Contents of one topic."""

    topic: Topic
    fields: dict[str, FieldStats]
    stamp: str | None  # field of timestamps
    unit: str | None  # of its numbers; None: it has a time type
    problem: str = ""  # reason why its numbers could not be read

    @property
    def span(self) -> tuple[float, float]:
        """First and last timestamp [s]."""
        scale = SECONDS[self.unit or "s"]
        spread = self.fields[self.stamp].spread if self.stamp in self.fields else RunningStats()
        return (scale * spread.least, scale * spread.most) if spread.many else (np.nan, np.nan)


def is_log(path: Path) -> bool:
    """Return whether a file or folder names its channels itself."""
    return path.suffix.lower() == ".toml" or not path.exists() or readers.has_tables(path)


def contents(path: Path) -> list[TopicContents]:
    """Return the contents of a file; raise UserError if it cannot be read."""
    kind = readers.format_of(path, path.name)
    source = Source(path, "", [], set(), None, path.name, topics={""}, cache={})
    topics = list(TOPICS[kind](source))
    source = source._replace(topics={topic.name for topic in topics}, cache={})
    out = [_contents(source, topic, kind) for topic in topics]
    if not any(topic.fields for topic in out):
        raise UserError(f"{path}: got no field of numbers, expected one at least; see whether this is the right file.")
    return out


def _contents(source: Source, topic: Topic, kind: readers.Format) -> TopicContents:
    fields = list(dict.fromkeys([*topic.times, *topic.numbers]))
    source = source._replace(topic=topic.name, frame=topic.frame, fields=fields, times=set(topic.times))
    stats, problem = {field: FieldStats() for field in fields}, topic.problem
    try:
        for part in kind.columns(source) if fields else ():
            stats = {field: _update(stats[field], part[field]) for field in fields}
    except UserError as error:
        if not stats or kind not in readers.MESSAGES:
            raise
        problem = str(error)
    if topic.times and kind is not readers.TABLE:
        return TopicContents(topic, stats, topic.times[0], None, problem)
    monotonic = [
        field for field in topic.numbers if stats[field].rows == stats[field].spread.many and not stats[field].falls
    ]
    first = [*topic.times, *(field for field in monotonic if field == fields[0] and len(fields) > 1)]
    matches = [field for field in (*topic.times, *monotonic, *topic.numbers, *topic.words) if TIME.match(field)]
    stamp = next(iter(matches or first), None)
    if stamp in topic.times or stamp in topic.words:
        problem = problem or (_time_problem(str(stamp), stats.get(str(stamp))) if matches else "")
        return TopicContents(topic, stats, stamp, None, problem)
    unit = tables.name_and_unit(stamp)[1] if stamp else None
    if stamp and unit not in SECONDS:
        unit = next((unit for least, unit in EPOCHS if stats[stamp].spread.most > least), "s")
    return TopicContents(topic, stats, stamp, unit, problem or _time_problem(stamp, stats[stamp]) if stamp else problem)


def _time_problem(stamp: str, s: FieldStats | None) -> str:
    """Return the problem with the times of a table; empty: none."""
    if s is None:
        return f"column '{stamp}' contains text that is not a time, expected seconds or ISO 8601; convert its values."
    empty, wrong = s.rows - s.spread.many, []
    if falls := s.falls:
        wrong.append(f"does not rise in {falls:,} row{'s' * (falls > 1)}: sort the rows, and remove repeated ones")
    if empty:
        wrong.append(f"is empty in {empty:,} row{'s' * (empty > 1)}: remove {'them' if empty > 1 else 'it'}")
    return f"column '{stamp}' of times {', and '.join(wrong)}." if wrong else ""


def _update(s: FieldStats, numbers: Floats) -> FieldStats:
    with np.errstate(invalid="ignore"):  # infinite values
        steps = np.diff(numbers, prepend=s.last)
    return FieldStats(
        spread=add(s.spread, np.arange(s.rows + 1, s.rows + 1 + len(numbers)), numbers),
        rows=s.rows + len(numbers),
        repeats=s.repeats + int((steps == 0).sum()),
        falls=s.falls + int((steps <= 0).sum()),
        last=float(numbers[-1]) if len(numbers) else s.last,
    )


def rows_of(topics: list[TopicContents]) -> list[dict[str, Any]]:
    """Return one row per field that is not a time, times in seconds; a topic without numbers has a row without a field."""
    rows = []
    for c in topics:
        first, last = c.span
        numbers = {field: s for field, s in c.fields.items() if field not in c.topic.times}
        for field, s in (numbers or {"": c.fields.get(str(c.stamp), FieldStats())}).items():
            count = s.spread.many
            rows.append(
                {
                    **{"topic": c.topic.name, "frame": c.topic.frame, "kind": c.topic.kind, "field": field},
                    **{"rows": s.rows, "missing": s.rows - count, "first": first, "last": last},
                    "rate": (count - 1) / (last - first) if last > first and count > 1 else np.nan,
                    **{"least": s.spread.least if count else np.nan, "most": s.spread.most if count else np.nan},
                    **{"constant": s.constant, "repeats": s.repeats},
                }
            )
    return rows


def starter_toml(path: Path, topics: list[TopicContents], folder: Path) -> str:
    """Return a TOML in `folder` that maps fields to channels and inputs; unlikely ones are comments."""
    kind, counts = readers.format_of(path, path.name), {"channels": 0, "inputs": 0}
    units = {c.unit for c in topics if c.unit not in (None, "s") and tables.name_and_unit(str(c.stamp))[1] != c.unit}
    lines = [
        "# Keep the fields that your plant measures, in the order of its outputs, and write their units.",
        f"log = {_text(os.path.relpath(path, folder))}",
        *(f"time_unit = {_text(unit)}  # by the size of the numbers" for unit in sorted(map(str, units))[:1]),
        *([] if any(c.stamp for c in topics) else ["period = 1.0  # [s] from one row to the next: write yours"]),
    ]
    for c in topics:
        arrival = None if kind.arrived else _arrival(c)
        for field, s in c.fields.items():
            if field in (c.stamp, arrival) or field in c.topic.times or not s.spread.many:
                continue
            name, unit = tables.name_and_unit(field)
            is_input = INPUT.fullmatch(name) or INPUT.fullmatch(c.topic.name)
            table, letter, key = ("inputs", "u", "t") if is_input else ("channels", "y", "sampled")
            is_dead = s.constant and not (is_input and s.spread.most)
            is_unlikely = COUNTER.fullmatch(name) or TIME.match(name) or is_dead
            prefix = "# " if counts[table] >= ACTIVE or is_unlikely else ""
            counts[table] += not prefix
            is_unit = unit and len(unit) <= LONGEST_UNIT and UNIT.fullmatch(unit)
            entry = {"topic": c.topic.name, "frame": c.topic.frame, "field": field, "unit": unit if is_unit else "1"}
            entry[key] = c.stamp if c.stamp != kind.stamp else ""
            block = [f"[{table}.{letter}{counts[table] + bool(prefix)}]  # {s.spread.least:.6g} to {s.spread.most:.6g}"]
            block += [f"{key} = {_text(value)}" for key, value in entry.items() if value]
            if arrival and not is_input:
                block.append(f"arrived = {_text(arrival)}")
            elif not (is_input or kind.arrived):
                block.append("delay = 0.0  # [s] from the timestamp to the arrival")
            lines += ["", *(prefix + line for line in block)]
    return "\n".join(lines) + "\n"


def _arrival(c: TopicContents) -> str | None:
    """Return the field of the times of arrival: named so, complete, and never before the timestamps at both ends."""
    stamps = c.fields.get(str(c.stamp), FieldStats())
    if not stamps.spread.many:
        return None
    for field, s in c.fields.items():
        name, unit = tables.name_and_unit(field)
        if field == c.stamp or not ARRIVAL.match(name) or unit != tables.name_and_unit(str(c.stamp))[1]:
            continue
        complete = s.spread.many == stamps.spread.many
        if complete and s.spread.least >= stamps.spread.least and s.spread.most >= stamps.spread.most:
            return field
    return None


def _text(value: str) -> str:
    """Return a text in TOML form."""
    return json.dumps(value, ensure_ascii=False)
