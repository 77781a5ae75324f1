"""MCAP files, read by mcap: messages as JSON, or of ROS 2 if mcap-ros2-support is installed."""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pcbench.errors import UserError
from pcbench.recordings import messages
from pcbench.recordings.decompression import require_small_mcap
from pcbench.recordings.log import Columns, Source, Topic, convert_errors, require_topic

if TYPE_CHECKING:
    from mcap.reader import McapReader
    from mcap.records import Channel, Message, Schema


def topics(source: Source) -> Iterator[Topic]:
    """Yield the topics, each by its first message; one with an unsupported encoding has no fields."""
    with _open_reader(source) as reader:
        summary = reader.get_summary()
        schemas, channels = (summary.schemas, summary.channels) if summary else ({}, {})
        kinds = {channel.topic: getattr(schemas.get(channel.schema_id), "name", "") for channel in channels.values()}
        for schema, channel, _ in () if summary else reader.iter_messages(log_time_order=False):
            kinds.setdefault(channel.topic, getattr(schema, "name", ""))
        for name, kind in kinds.items():
            raw = reader.iter_messages(topics=[name], log_time_order=False)
            try:
                yield from messages.topic_of(_decode(raw, source.where), name, kind)
            except UserError:
                yield Topic(name, f"{kind}, of an encoding that is not read", [])


def columns(source: Source) -> Iterator[Columns]:
    """Yield parts of a topic's fields."""
    with _open_reader(source) as reader:
        summary = reader.get_summary()
        if summary is not None:
            require_topic(source.topic, {channel.topic for channel in summary.channels.values()}, source.where)
        # in order of time; without an index in file order, as sorting would hold all messages in memory
        has_index = summary is not None and bool(summary.chunk_indexes)
        raw = reader.iter_messages(topics=[source.topic], log_time_order=has_index)
        yield from messages.columns(_decode(raw, source.where), source)


@contextmanager
def _open_reader(source: Source) -> Iterator["McapReader"]:
    """Yield the reader of a file; its exceptions become UserErrors."""
    from mcap.reader import make_reader

    with convert_errors(source, "a complete MCAP file; repair it with mcap recover"):
        if not source.cache:
            require_small_mcap(source.path, source.place)
            source.cache["is small"] = True
        with source.path.open("rb") as file:
            yield make_reader(file, validate_crcs=True)  # without CRC validation damaged data is skipped silently


def _decode(raw: Iterable["tuple[Schema | None, Channel, Message]"], where: str) -> Iterator[tuple[int, object]]:
    decoders: dict[int, Callable[[bytes], object]] = {}
    for schema, channel, message in raw:
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(channel.message_encoding, schema, where)
        yield message.log_time, decoders[channel.id](message.data)


def _decoder(encoding: str, schema: "Schema | None", where: str) -> Callable[[bytes], object]:
    if encoding == "json":
        return json.loads
    if encoding == "cdr":
        from mcap_ros2.decoder import DecoderFactory

        decoder = DecoderFactory().decoder_for(encoding, schema)
        if decoder is not None:
            return decoder
    raise UserError(
        f"{where}: got messages encoded as {encoding}, expected json or cdr (of ROS 2); convert the file, or write its "
        "numbers as CSV."
    )
