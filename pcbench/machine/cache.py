"""The folder of everything that pcbench can make again; PCBENCH_CACHE names it. No jax."""

import os
import tempfile
from pathlib import Path

from platformdirs import user_cache_path


def folder() -> Path:
    """Return the folder of everything pcbench can make again."""
    return Path(os.environ.get("PCBENCH_CACHE") or user_cache_path("pcbench"))


def keep(path: Path, content: str | bytes) -> None:
    """Put a text or bytes into the cache, whole or not at all; where they cannot be written, that only costs time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as beside:
            beside.write(content.encode() if isinstance(content, str) else content)
        os.replace(beside.name, path)
    except OSError:
        return
