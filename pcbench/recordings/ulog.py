"""Flight logs of PX4 (ULog), read by pyulog. Timestamps are microseconds since start; a topic's instance n is "topic.n".

The reader can only read a ULog as a whole. It is read once for all channels and passes, and only requested topics are kept.
"""

from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO

import numpy as np

from pcbench.errors import UserError, unknown
from pcbench.recordings.log import SECONDS, Columns, Source, Topic, convert_errors, require_topic


def columns(source: Source) -> Iterator[Columns]:
    """Yield a topic's fields. A message without timestamp_sample has the time at which it was logged."""
    name, _, instance = source.topic.partition(".")
    topic = f"{name}.{instance}" if instance not in ("", "0") else name
    if not source.cache:
        source.cache.update(_topics(source, sorted({topic.partition(".")[0] for topic in source.topics})))
    if topic not in source.cache:
        require_topic(topic, _topics(source, None), source.where)
    data, out = source.cache[topic], {}
    for field in source.fields:
        column = "timestamp" if field == "timestamp_sample" and field not in data else field
        if column not in data:
            raise unknown(f"{source.where}: {source.topic}", "field", field, data)
        out[field] = np.asarray(data[column], float) * (SECONDS["us"] if field in source.times else 1.0)
    yield out


def topics(source: Source) -> Iterator[Topic]:
    """Yield the topics, with their instances."""
    for name, data in _topics(source, None).items():
        times = [column for column in ("timestamp_sample", "timestamp") if column in data]
        yield Topic(name, "topic", [column for column in data if column not in times], times)


def _topics(source: Source, names: list[str] | None) -> dict[str, dict[str, np.ndarray]]:
    """Return the fields of topics of these names (None: all), by topic."""
    from pyulog import ULog

    with (
        convert_errors(source, "a complete ULog; correct it"),
        redirect_stdout(StringIO()) as remarks,
    ):  # of skipped data
        log = ULog(str(source.path), names)
    if log.file_corruption or "corrupt" in remarks.getvalue():
        raise UserError(
            f"{source.place}: got records that cannot be read among others, expected a complete ULog; correct it."
        )
    return {f"{d.name}.{d.multi_id}" if d.multi_id else d.name: d.data for d in log.data_list}
