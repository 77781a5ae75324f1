"""Bags of ROS 1 and ROS 2, read by rosbags: a .bag, a folder with its metadata, or one .db3."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pcbench.recordings import messages
from pcbench.recordings.decompression import require_small_bag
from pcbench.recordings.log import Columns, Source, Topic, reading, require_topic

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


def topics(source: Source) -> Iterator[Topic]:
    """Yield the topics, each by its first message."""
    with _opened(source) as reader:
        for name, topic in reader.topics.items():
            raw = reader.messages(connections=topic.connections)
            decoded = ((received, reader.deserialize(data, of.msgtype)) for of, received, data in raw)
            yield from messages.topic_of(decoded, name, topic.msgtype or "several types")


def columns(source: Source) -> Iterator[Columns]:
    """Yield parts of a topic's fields."""
    with _opened(source) as reader:
        require_topic(source.topic, reader.topics, source.where)
        raw = reader.messages(connections=reader.topics[source.topic].connections)
        decoded = ((received, reader.deserialize(data, of.msgtype)) for of, received, data in raw)
        yield from messages.columns(decoded, source)


@contextmanager
def _opened(source: Source) -> Iterator["AnyReader"]:
    """Yield the reader of a bag; its exceptions become UserErrors."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with reading(source, "a whole bag; repair it with rosbag reindex or ros2 bag reindex, or record it again"):
        if not source.loaded:
            require_small_bag(source.path, source.place)
            source.loaded["is small"] = True
        with AnyReader([source.path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
