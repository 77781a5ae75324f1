"""MCAP files, read by mcap: messages as JSON, or of ROS 2 where mcap-ros2-support is installed too."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pcbench.errors import UserError, unreadable
from pcbench.recordings.decompression import once, require_small_mcap
from pcbench.recordings.log import Floats
from pcbench.recordings.messages import parts, require_topic


def fields(
    path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
) -> Iterator[dict[str, Floats]]:
    """Yield parts of a topic's fields, [K] each; stamps in seconds."""
    from mcap.reader import make_reader

    try:
        once(require_small_mcap, path, f"{where}: {path.name}", path.stat().st_mtime_ns)
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)  # else what is damaged is left out without a word
            summary = reader.get_summary()
            if summary is not None:
                require_topic(topic, {channel.topic for channel in summary.channels.values()}, where)
            indexed = summary is not None and bool(summary.chunk_indexes)
            yield from parts(_messages(reader, topic, where, indexed), wanted, times, unit, where)
    except (UserError, ImportError):
        raise
    except Exception as error:  # of the reader, of a decompressor or of a message that is none
        raise unreadable(error, f"{where}: {path.name}", "a whole MCAP file; mend it") from None


def _messages(reader: Any, topic: str, where: str, indexed: bool) -> Iterator[tuple[int, Any]]:
    """Messages in the order of their times; without an index as they were written, for to sort them all would be held."""
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for schema, channel, message in reader.iter_messages(topics=[topic], log_time_order=indexed):
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(channel.message_encoding, schema, where)
        yield message.log_time, decoders[channel.id](message.data)


def _decoder(encoding: str, schema: Any, where: str) -> Callable[[bytes], Any]:
    if encoding == "json":
        return json.loads
    if encoding == "cdr":
        from mcap_ros2.decoder import DecoderFactory

        found = DecoderFactory().decoder_for(encoding, schema)
        if found is not None:
            return found
    raise UserError(
        f"{where}: got messages encoded as {encoding}, expected json or cdr (of ROS 2); convert the file, or write its "
        "numbers as CSV."
    )
