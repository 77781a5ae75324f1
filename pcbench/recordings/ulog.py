"""Flight logs of PX4 (ULog), read by pyulog. Stamps are microseconds since start; a topic's instance n is "topic.n".

A ULog is read as a whole, for its reader has no other way: once, however many channels and passes there are, and of its topics
only those that are asked for are held.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from pcbench.errors import UserError, unknown, unreadable
from pcbench.recordings.log import Floats
from pcbench.recordings.messages import require_topic

MICROSECOND = 1e-6


def reader(topics: Iterable[str]) -> Callable[..., Iterator[dict[str, Floats]]]:
    """Return what reads fields of these topics of one file, which is loaded when the first is asked for."""
    names = sorted({topic.partition(".")[0] for topic in topics})
    loaded: dict[str, Any] = {}

    def fields(
        path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
    ) -> Iterator[dict[str, Floats]]:
        """Yield a topic's fields, [K] each; stamps in seconds. A message without stamp_sample is stamped when it was logged."""
        name, _, instance = topic.partition(".")
        asked = f"{name}.{instance}" if instance not in ("", "0") else name
        if not loaded:
            loaded.update(_topics(path, names, where))
        if asked not in loaded:
            require_topic(asked, _topics(path, None, where), where)
        data = loaded[asked]
        out = {}
        for field in wanted:
            place = "timestamp" if field == "timestamp_sample" and field not in data else field
            if place not in data:
                raise unknown(f"{where}: {topic}", "field", field, data)
            out[field] = np.asarray(data[place], float) * (MICROSECOND if field in times else 1.0)
        yield out

    return fields


def _topics(path: Path, names: list[str] | None, where: str) -> dict[str, Any]:
    """The fields of topics of these names (None: of all), by topic."""
    from pyulog import ULog

    try:
        with redirect_stdout(StringIO()) as remarks:  # how its reader says what it has passed over
            log = ULog(str(path), names)
    except Exception as error:  # pyulog raises TypeError and struct.error among others
        raise unreadable(error, f"{where}: {path.name}", "a whole ULog; mend it") from None
    if log.file_corruption or "corrupt" in remarks.getvalue():
        raise UserError(
            f"{where}: {path.name}: got records that cannot be read among others, expected a whole ULog; mend it."
        )
    return {f"{d.name}.{d.multi_id}" if d.multi_id else d.name: d.data for d in log.data_list}
