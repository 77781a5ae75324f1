"""Fields of messages, one after the other: of bags, whose readers hand out objects or dictionaries."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from pcbench.errors import UserError
from pcbench.recordings.log import Floats
from pcbench.recordings.units import SECONDS

MANY = 1 << 14  # messages of a part
RECEIVED = "received"  # in place of a field: when the recorder got the message
STAMP = (
    ("sec", "nanosec"),
    ("sec", "nsec"),
    ("secs", "nsecs"),
)  # how ROS 2, MCAP's schemas and ROS 1 call the parts of one


def parts(
    messages: Iterable[tuple[int, Any]], fields: list[str], times: set[str], unit: str | None, where: str
) -> Iterator[dict[str, Floats]]:
    """Yield parts of fields, [K] each, of messages (received [ns], message); `times` in seconds, plain ones in `unit`."""
    found: list[list[float]] = []
    for number, (received, message) in enumerate(messages, 1):
        place = f"{where}: message {number}"
        found.append([_number(received, message, f, f in times, unit, place) for f in fields])
        if len(found) == MANY:
            yield _columns(fields, found)
            found = []
    if found:
        yield _columns(fields, found)


def _columns(fields: list[str], rows: list[list[float]]) -> dict[str, Floats]:
    return dict(zip(fields, np.array(rows, float).T, strict=True))


def _number(received: int, message: Any, field: str, time: bool, unit: str | None, where: str) -> float:
    if field == RECEIVED:
        return _seconds(*divmod(received, 10**9))
    value = message
    for part in field.split("."):
        value = _inside(value, part, field, where)
    if time:
        for whole, rest in STAMP:
            if _has(value, whole) and _has(value, rest):
                return _seconds(_get(value, whole), _get(value, rest))
    try:
        return float(value) * (SECONDS[unit or "s"] if time else 1.0)
    except (TypeError, ValueError):
        raise UserError(
            f"{where}: {field}: got a {type(value).__name__}, expected a number; name a field within it, such as {field}.x."
        ) from None


def _seconds(whole: float, ns: float) -> float:
    """What a stamp says [s], rounded alike wherever it stood: what was received when it was stamped came no earlier."""
    return float(whole) + 1e-9 * float(ns)


def _inside(value: Any, part: str, field: str, where: str) -> Any:
    if part.isdecimal() and hasattr(value, "__len__"):
        if int(part) < len(value):
            return value[int(part)]
    elif _has(value, part):
        return _get(value, part)
    known = list(value) if isinstance(value, dict) else [n for n in dir(value) if n[0] != "_"]
    raise UserError(f"{where}: {field}: got no '{part}' among {', '.join(map(str, known[:12]))}; write one of them.")


def _has(value: Any, part: str) -> bool:
    return part in value if isinstance(value, dict) else hasattr(value, part)


def _get(value: Any, part: str) -> Any:
    return value[part] if isinstance(value, dict) else getattr(value, part)


def require_topic(topic: str, there: Iterable[str], where: str) -> None:
    """Raise UserError for a topic that a bag does not have."""
    known = sorted(there)
    if topic not in known:
        got = f"the topic '{topic}'" if topic else "no topic"
        raise UserError(f"{where}: got {got}, expected one of {', '.join(known) or 'none: it is empty'}; write that.")
