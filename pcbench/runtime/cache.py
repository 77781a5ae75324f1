"""The cache folder for everything that pcbench can recompute; PCBENCH_CACHE sets it. No jax.

The cache contains machine code, so only its owner may write to it. pcbench refuses a folder that others may change.
"""

import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from platformdirs import user_cache_path

from pcbench.errors import UserError
from pcbench.runtime import ending


def folder(*parts: str) -> Path:
    """Return the cache folder, or a folder in it, created if possible.

    Raises UserError if another user owns it or may write to it.
    """
    path = Path(os.environ.get("PCBENCH_CACHE") or user_cache_path("pcbench"))
    for part in [path, *(path.joinpath(*parts[: i + 1]) for i in range(len(parts)))]:
        _require_private(part)
    return path.joinpath(*parts)


def _require_private(path: Path) -> None:
    with suppress(OSError):  # if it cannot be created, pcbench recomputes and stores nothing
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        status = path.stat()
    except OSError:
        return
    if not hasattr(os, "geteuid"):  # a system without POSIX permissions
        return
    if status.st_uid != os.geteuid():
        raise UserError(
            f"{path}: got a cache that another user owns, expected one of yours: it contains programs, which are run; name a "
            "folder of yours with PCBENCH_CACHE."
        )
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UserError(
            f"{path}: got a cache that other users may write to, expected one that only you may change: it holds programs, "
            "which are run; remove it, or name a folder of yours alone with PCBENCH_CACHE."
        )


def keep(path: Path, content: str | bytes) -> None:
    """Write a text or bytes to the cache atomically; a failure is ignored and only costs time."""
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with ending.uncut():
            with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as temporary:
                temporary.write(content.encode() if isinstance(content, str) else content)
            os.replace(temporary.name, path)
    except OSError:
        return
