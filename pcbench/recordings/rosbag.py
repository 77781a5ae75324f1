"""Bags of ROS 1 and ROS 2, read by rosbags: a .bag, a folder with its metadata, or one .db3."""

from collections.abc import Iterator

from pcbench.recordings import messages
from pcbench.recordings.decompression import require_small_bag
from pcbench.recordings.log import Columns, Source, reading, require_topic


def columns(source: Source) -> Iterator[Columns]:
    """Yield parts of a topic's fields."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with reading(source, "a whole bag; mend or convert it"):
        if not source.loaded:
            require_small_bag(source.path, source.place)
            source.loaded["is small"] = True
        with AnyReader([source.path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            require_topic(source.topic, reader.topics, source.where)
            connections = [each for each in reader.connections if each.topic == source.topic]
            raw = reader.messages(connections=connections)
            decoded = ((received, reader.deserialize(data, of.msgtype)) for of, received, data in raw)
            yield from messages.columns(decoded, source)
