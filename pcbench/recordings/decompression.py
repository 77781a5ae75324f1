"""Limit the unpacked size of a compressed recording before it takes memory.

A file of a few kilobytes can unpack to gigabytes. Unpacked, a recording may have PLAIN bytes, or RATIO times the bytes of its
file if that is more. For a bag or MCAP this applies to each chunk, as its reader unpacks one at a time. Sizes stated in the
file are ignored: every compressed part is unpacked in steps and counted before its reader unpacks it at once.
"""

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa

from pcbench.errors import UserError

PLAIN = 64 * 2**20
RATIO = 50  # recordings of sensors compress by factors of 2 to 20
STEP = 2**16  # bytes unpacked at a time
HEADER = 128  # bytes of a MATLAB file before its first variable
COMPRESSED = 15  # the type of a compressed variable
MCAP, SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"  # first bytes of such files


def require_small(size: int, file_size: int, where: str) -> None:
    """Raise UserError if the unpacked size [bytes] is too large for the size of the file [bytes]."""
    limit = max(PLAIN, RATIO * file_size)
    if size > limit:
        raise UserError(
            f"{where}: got {file_size / 1e6:.3g} MB that unpack to more than {limit / 1e6:.3g} MB, expected at most {RATIO} "
            "times as much; save it without compression."
        )


def require_small_mat(path: Path, where: str) -> None:
    """Raise UserError if a MATLAB file of format 5 to 7 is too large unpacked."""
    size, total = path.stat().st_size, 0
    with path.open("rb") as file:
        order = {b"IM": "<", b"MI": ">"}.get(file.read(HEADER)[126:])
        while order is not None and len(tag := file.read(8)) == 8:
            kind, many = struct.unpack(f"{order}II", tag)
            end = file.tell() + many
            for unpacked_size in _sizes(file.read(many)) if kind == COMPRESSED else [many]:
                total += unpacked_size
                require_small(total, size, where)
            file.seek(end)


def _sizes(chunk: bytes) -> Iterator[int]:
    """Yield the unpacked sizes of the parts of a compressed variable; damage ends the iteration, as the reader reports it."""
    unpack = zlib.decompressobj()
    with suppress(zlib.error):
        while chunk and not unpack.eof:
            yield len(unpack.decompress(chunk, STEP))
            chunk = unpack.unconsumed_tail


def require_small_stream(stream: BinaryIO, codec: str, size: int, where: str) -> None:
    """Raise UserError if data packed as zstd, lz4 or bz2, of `size` bytes, is too large unpacked."""
    total = 0
    with _ignore_damage(), pa.CompressedInputStream(stream, codec) as file:
        while step := len(file.read(STEP)):
            total += step
            require_small(total, size, where)


@contextmanager
def _ignore_damage() -> Iterator[None]:
    """Ignore damage in a check, as the reader reports it."""
    try:
        yield
    except UserError:
        raise
    except Exception:
        return


def require_small_mcap(path: Path, where: str) -> None:
    """Raise UserError if a chunk of an MCAP file is too large unpacked, found by its records or its index."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        _require_small_chunks(file, where)
        file.seek(0)
        summary = make_reader(file).get_summary()
        for chunk in [] if summary is None else summary.chunk_indexes:
            require_small(chunk.uncompressed_size, chunk.compressed_size, where)
            file.seek(chunk.chunk_start_offset)
            _require_small_chunks(file, where, 1)


def _require_small_chunks(file: BinaryIO, where: str, most: int | None = None) -> None:
    """Check the packed chunks among the records of an MCAP file: all, or the first few from the present position."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    with _ignore_damage():
        for record in islice(StreamReader(file, skip_magic=most is not None, emit_chunks=True).records, most):
            if isinstance(record, Chunk) and record.compression in ("zstd", "lz4"):
                require_small_stream(BytesIO(record.data), record.compression, len(record.data), where)


def require_small_bag(path: Path, where: str) -> None:
    """Raise UserError if a file, a chunk (ROS 1) or a packed message (ROS 2) of a bag is too large unpacked."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    for member in filter(Path.is_file, path.iterdir() if path.is_dir() else [path]):
        with member.open("rb") as file:
            head = file.read(len(SQLITE))
            if not head.startswith((MCAP, SQLITE)) and member.suffix != ".bag":
                file.seek(0)
                require_small_stream(file, "zstd", member.stat().st_size, where)
        if head.startswith(MCAP):
            require_small_mcap(member, where)
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        for reader in bag.readers:
            for chunk in getattr(reader, "chunks", {}).values():
                codec = chunk.decompressor.__module__.partition(".")[0]  # name of its package
                with path.open("rb") as file:
                    file.seek(chunk.datapos)
                    if codec in ("bz2", "lz4"):
                        require_small_stream(BytesIO(file.read(chunk.datasize)), codec, chunk.datasize, where)
            inner: Any = getattr(reader, "storage", reader)
            if getattr(getattr(inner, "metadata", None), "compression_mode", None) == "message":
                for storage in inner.storages:
                    for _, _, data in storage.messages(storage.connections):
                        require_small_stream(BytesIO(data), "zstd", len(data), where)
