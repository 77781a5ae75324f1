"""Files and folders of this machine: made new, found without following symbolic links, kept over a power cut. No jax."""

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from pcbench.errors import UserError

NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)  # some systems have none


def create(path: str | Path) -> int:
    """Make a file and return the handle to write it; raise FileExistsError where there is one, or a link."""
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_FOLLOW, 0o666)


def links(root: str, name: str) -> list[str]:
    """Return the parts of a name below a folder that are symbolic links, the outermost first."""
    parts = name.split("/") if name else []
    every = ["/".join(parts[: i + 1]) for i in range(len(parts))]
    return [each for each in every if os.path.islink(f"{root}/{each}")]


def files(folder: str) -> Iterator[tuple[str, int]]:
    """Yield the paths and sizes of all files below a folder, and of links, which are not followed."""
    try:
        entries = list(os.scandir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from files(entry.path)
        else:
            with suppress(FileNotFoundError):
                yield entry.path, entry.stat(follow_symlinks=False).st_size


def make_folders(root: str, name: str) -> None:
    """Make the folders that a name asks for below the root; a root that has been removed is not made again."""
    folder = Path(root)
    for part in Path(name).parent.parts:
        folder /= part
        if not folder.is_dir():
            folder.mkdir(exist_ok=True)
            sync_folder(folder.parent)


def sync_folder(folder: Path) -> None:
    """Let the names of the files in a folder outlast a power cut."""
    with suppress(OSError):  # not every file system lets a folder be opened
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def require_printable(root: str) -> None:
    """Raise UserError for a path that this process's encoding cannot write."""
    try:
        root.encode()
        os.fsencode(root)
    except UnicodeEncodeError:
        raise UserError(
            f"{root}: got a name that this process cannot write, whose encoding is {sys.getfilesystemencoding()}, expected "
            "UTF-8; set LC_ALL=C.UTF-8 or PYTHONUTF8=1, or give a name of ASCII letters."
        ) from None
