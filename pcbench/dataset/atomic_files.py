"""Files that belong together: all of them, or those of before. No jax."""

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import pyarrow as pa

from pcbench.dataset import storage
from pcbench.runtime import ending


def put_all(target: storage.Target, files: Mapping[str, bytes | pa.Buffer]) -> None:
    """Put files that belong together: in a folder of this machine all of them, or none where this is stopped."""
    if not target.local:
        for name, content in files.items():
            storage.put(target, name, content)
        return
    beside = {name: f"{Path(name).parent}/.{Path(name).name}-{os.getpid()}" for name in files}
    root = Path(target.root)
    with ending.uncut():
        try:
            for name, content in files.items():
                storage.put(target, beside[name], content)
            with storage.said(target.name):
                renamed([(root / beside[name], root / name) for name in files])
        finally:
            for each in beside.values():
                with suppress(OSError):
                    (root / each).unlink(missing_ok=True)


def renamed(pairs: Iterable[tuple[Path, Path]]) -> None:
    """Give files that belong together their names; who is stopped in the middle does so first."""
    left = list(pairs)
    try:
        with ending.uncut():
            while left:
                os.replace(*left[0])
                del left[0]
    except KeyboardInterrupt:
        for beside, name in left:
            with suppress(FileNotFoundError):  # it has its name already
                os.replace(beside, name)
        raise
