"""Bags of ROS 1 and ROS 2, read by rosbags: a .bag, a folder with its metadata, or one .db3."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pcbench.recordings import messages
from pcbench.recordings.decompression import require_small_bag
from pcbench.recordings.log import Columns, Source, Topic, convert_errors, require_topic

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import TopicInfo


def topics(source: Source) -> Iterator[Topic]:
    """Yield the topics, each by its first message."""
    with _open_reader(source) as reader:
        for name, topic in reader.topics.items():
            yield from messages.topic_of(_decode(reader, topic), name, topic.msgtype or "several types")


def columns(source: Source) -> Iterator[Columns]:
    """Yield parts of a topic's fields."""
    with _open_reader(source) as reader:
        require_topic(source.topic, reader.topics, source.where)
        yield from messages.columns(_decode(reader, reader.topics[source.topic]), source)


def _decode(reader: "AnyReader", topic: "TopicInfo") -> Iterator[tuple[int, object]]:
    for connection, receive_time, raw in reader.messages(connections=topic.connections):
        yield receive_time, reader.deserialize(raw, connection.msgtype)


@contextmanager
def _open_reader(source: Source) -> Iterator["AnyReader"]:
    """Yield the reader of a bag; its exceptions become UserErrors."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with convert_errors(
        source, "a complete bag; repair it with rosbag reindex or ros2 bag reindex, or record it again"
    ):
        if not source.cache:
            require_small_bag(source.path, source.place)
            source.cache["is small"] = True
        with AnyReader([source.path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
