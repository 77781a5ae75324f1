"""Fields of messages in bags and MCAP files, whose readers return objects or dictionaries."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from pcbench.errors import UserError, unknown
from pcbench.recordings.log import MOST, SECONDS, Columns, Source, Topic

MANY, FRAMES = 1 << 14, 100  # messages per part, listed frames per topic
SHORT = 9  # largest list whose entries are separate fields, such as a covariance of three numbers
RECEIVED = "received"  # pseudo-field: the receive time of the message
STAMP = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"))  # parts of a timestamp in ROS 2, MCAP schemas, ROS 1
NONE = object()  # marks a missing field


def columns(messages: Iterable[tuple[int, object]], source: Source) -> Iterator[Columns]:
    """Yield parts of the fields of messages (received [ns], message); times in seconds, numbers in the source's time unit."""
    rows: list[list[float]] = []
    for number, (receive_time, message) in enumerate(_of_frame(messages, source) if source.frame else messages, 1):
        rows.append([_number(receive_time, message, field, source, number) for field in source.fields])
        if len(rows) == MANY:
            yield dict(zip(source.fields, np.array(rows, float).T, strict=True))
            rows = []
    if rows:
        yield dict(zip(source.fields, np.array(rows, float).T, strict=True))


def topic_of(messages: Iterable[tuple[int, object]], name: str, kind: str) -> Iterator[Topic]:
    """Yield the topic with the fields of its first message; for transforms one topic per frame."""
    frames: dict[str, None] = {}
    for _, message in messages:
        transforms = _member(message, "transforms")
        if not isinstance(transforms, list):
            numbers, times = _leaves(message)
            yield Topic(name, kind, numbers, [*times, RECEIVED])
            return
        for transform in transforms:
            frame = str(_member(transform, "child_frame_id"))
            if frame not in frames and len(frames) < FRAMES:
                frames[frame] = None
                numbers, times = _leaves(transform)
                yield Topic(name, kind, numbers, [*times, RECEIVED], frame)
    if not frames:
        yield Topic(name, f"{kind}, no messages", [])


def _leaves(message: object, prefix: str = "", depth: int = 8) -> tuple[list[str], list[str]]:
    """Return the fields of a message that are numbers, and those that are times; long lists are left out."""
    numbers, times = [], []
    for name in _names(message):
        value, path = _member(message, name), f"{prefix}{name}"
        if isinstance(value, bool | int | float | np.number):
            numbers.append(path)
        elif isinstance(value, list | tuple | np.ndarray):
            short = value if len(value) <= SHORT else []
            numbers += [f"{path}.{i}" for i, number in enumerate(short) if isinstance(number, int | float | np.number)]
        elif any(all(_member(value, part) is not NONE for part in pair) for pair in STAMP):
            times.append(path)
        elif depth and not isinstance(value, str | bytes) and value is not None and not callable(value):
            inner = _leaves(value, f"{path}.", depth - 1)
            numbers, times = numbers + inner[0], times + inner[1]
    return numbers[:MOST], times


def _names(value: object) -> list[str]:
    return list(map(str, value)) if isinstance(value, dict) else [name for name in dir(value) if name[0] != "_"]


def _of_frame(messages: Iterable[tuple[int, object]], source: Source) -> Iterator[tuple[int, object]]:
    """Yield the transforms to one child frame, from messages with several."""
    frames: set[str] = set()
    for receive_time, message in messages:
        transforms = _member(message, "transforms")
        for transform in transforms if isinstance(transforms, list) else []:
            frames.add(str(_member(transform, "child_frame_id")))
            if _member(transform, "child_frame_id") == source.frame:
                yield receive_time, transform
    if source.frame not in frames:
        raise unknown(f"{source.where}: {source.topic}", "child frame", source.frame, frames)


def _number(receive_time: int, message: Any, field: str, source: Source, number: int) -> float:
    if field == RECEIVED:
        return _seconds(*divmod(receive_time, 10**9))
    where, value = f"{source.where}: message {number}", message
    for part in field.split("."):
        is_list = part.isdecimal() and hasattr(value, "__len__")
        inner = (value[int(part)] if int(part) < len(value) else NONE) if is_list else _member(value, part)
        if inner is NONE and field in source.times and source.default_stamp:
            return _seconds(*divmod(receive_time, 10**9))
        if inner is NONE:
            times = ', or sampled = "received" if it has no stamp' if field in source.times else ""
            raise UserError(
                f"{where}: {field}: got no '{part}' among {', '.join(_names(value)[:12])}; write one of them{times}."
            )
        value = inner
    if field in source.times:
        for pair in STAMP:
            stamp = [_member(value, name) for name in pair]
            if all(value is not NONE for value in stamp):
                return _seconds(*stamp)
    if value is None:  # null in JSON: not measured
        return math.nan
    try:
        return float(value) * (SECONDS[source.unit or "s"] if field in source.times else 1.0)
    except (TypeError, ValueError):
        raise UserError(
            f"{where}: {field}: got a {type(value).__name__}, expected a number; name a field within it, such as {field}.x."
        ) from None


def _seconds(seconds: float, ns: float) -> float:
    """Return a timestamp [s] with consistent rounding: a message received at its timestamp must not arrive earlier."""
    return float(seconds) + 1e-9 * float(ns)


def _member(value: object, name: str) -> Any:
    if isinstance(value, dict):
        return value.get(name, NONE)
    return getattr(value, name, NONE) if name[:1] != "_" else NONE
