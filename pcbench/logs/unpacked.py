"""How large a compressed recording is when it is unpacked, found out before it takes memory.

A file of a few kilobytes can unpack to gigabytes. Unpacked, a recording may have PLAIN bytes, or RATIO times the bytes of its
file if that is more.
"""

import zlib
from collections.abc import Iterable
from pathlib import Path

from pcbench.errors import UserError

PLAIN = 64 * 2**20
RATIO = 50  # recordings of sensors are compressed 2 to 20 times
STEP = 2**16  # bytes that are unpacked at a time
HEADER = 128  # bytes of a MATLAB file before its first variable
COMPRESSED = 15  # the type of a compressed variable


def require_small(unpacked: int, file: int, where: str) -> None:
    """Raise UserError if a recording is too large unpacked [bytes] for the size of its file [bytes]."""
    if unpacked > max(PLAIN, RATIO * file):
        raise UserError(
            f"{where}: got {file / 1e6:.3g} MB that unpack to more than {max(PLAIN, RATIO * file) / 1e6:.3g} MB, expected at "
            f"most {RATIO} times as much; save it without compression."
        )


def require_small_mat(path: Path, where: str) -> None:
    """Raise UserError if a MATLAB file of format 5 to 7 is too large unpacked."""
    size, found = path.stat().st_size, 0
    with path.open("rb") as file:
        order = {b"IM": "little", b"MI": "big"}.get(file.read(HEADER)[126:])
        while order is not None and len(tag := file.read(8)) == 8:
            kind, many = (int.from_bytes(tag[i : i + 4], "little" if order == "little" else "big") for i in (0, 4))
            end = file.tell() + many
            for unpacked in _parts(file.read(many)) if kind == COMPRESSED else [many]:
                found += unpacked
                require_small(found, size, where)
            file.seek(end)


def _parts(packed: bytes) -> Iterable[int]:
    """Yield the sizes of the parts that a compressed variable unpacks to; what is damaged ends it, its reader says so."""
    unpack = zlib.decompressobj()
    try:
        while packed and not unpack.eof:
            yield len(unpack.decompress(packed, STEP))
            packed = unpack.unconsumed_tail
    except zlib.error:
        return
