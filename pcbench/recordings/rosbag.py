"""Bags of ROS 1 and ROS 2, read by rosbags: a .bag, a folder with its metadata, or one .db3."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pcbench.errors import UserError, unreadable
from pcbench.recordings.decompression import once, require_small_bag
from pcbench.recordings.log import Floats
from pcbench.recordings.messages import parts, require_topic


def fields(
    path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
) -> Iterator[dict[str, Floats]]:
    """Yield parts of a topic's fields, [K] each; stamps in seconds."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        once(require_small_bag, path, f"{where}: {path.name}", path.stat().st_mtime_ns)
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            require_topic(topic, reader.topics, where)
            yield from parts(_messages(reader, topic), wanted, times, unit, where)
    except (UserError, ImportError):
        raise
    except Exception as error:  # a damaged bag is noticed by its reader, by the store below it or in a message
        raise unreadable(error, f"{where}: {path.name}", "a whole bag; mend or convert it") from None


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    mine = [connection for connection in reader.connections if connection.topic == topic]
    for connection, received, raw in reader.messages(connections=mine):
        yield received, reader.deserialize(raw, connection.msgtype)
