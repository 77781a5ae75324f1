"""Files of a run in a folder or an object store, each written completely or not at all. No jax.

In a folder, a file is written under a temporary name, synced and renamed. A reader sees the old file, the new one, or
none. A killed writer leaves at most its own unfinished file, which the next run removes. In an object store (any URI
that pyarrow supports: s3://, gs://, abfs://, hdfs://), a file is checked in memory and uploaded in one piece. It
appears completely or not at all if the store guarantees this (S3, GCS and Azure do). Two writers of one name write the
same bytes. There are no locks: the existing files are the finished ones. Symbolic links below a folder are not
followed.
"""

import itertools
import json
import os
import re
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from time import time
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.fs as pafs
import pyarrow.parquet as pq

from pcbench.dataset import parquet_io
from pcbench.errors import UserError, redact_address
from pcbench.runtime import ending

NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)  # some systems have none
PARTIAL = ".partial"
UNFINISHED = re.compile(r"\.(.+)-(\d+)-\d+" + re.escape(PARTIAL))  # host, process, count
ABANDONED_AGE = 86400.0  # [s] age at which an unfinished file of another machine is removed
_COUNT = itertools.count()
Json = dict[str, Any]  # an object: texts, numbers, lists and objects by key


class Target(NamedTuple):
    """The place of the tables: a folder, or a bucket."""

    fs: pafs.FileSystem
    root: str  # the path on it
    name: str  # as it was given, without a password
    uri: str  # as another process reaches it

    @property
    def local(self) -> bool:
        """Whether it is a folder of this machine."""
        return isinstance(self.fs, pafs.LocalFileSystem)


def target(out: str | Path) -> Target:
    """Return the target of a path or a URI; raise UserError if pyarrow cannot access it."""
    if not str(out).strip():
        raise UserError("--out: got an empty name, expected a folder or a URI; give one, or leave --out out.")
    if "://" in str(out):
        return _remote(str(out))
    root = str(Path(out).expanduser().absolute())
    try:
        root.encode()
        os.fsencode(root)
    except UnicodeEncodeError:
        raise UserError(
            f"{root}: got a name that this process cannot write, whose encoding is {sys.getfilesystemencoding()}, expected "
            "UTF-8; set LC_ALL=C.UTF-8 or PYTHONUTF8=1, or give a name of ASCII letters."
        ) from None
    return Target(pafs.LocalFileSystem(), root, str(out), root)


@lru_cache(maxsize=16)
def _remote(out: str) -> Target:
    name = redact_address(out)
    try:
        fs, root = pafs.FileSystem.from_uri(out)
    except (pa.ArrowException, ValueError, OSError, ImportError) as error:
        reason = f" ({_reason(error)})" if name == out else ""  # the reason may quote the password
        raise UserError(f"{name}: cannot be accessed{reason}; expected a path or a URI.") from None
    return Target(fs, root.rstrip("/"), name, out)


def create(path: str | Path) -> int:
    """Create a file and return the handle to write it; raise FileExistsError if a file or a link has that name."""
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_FOLLOW, 0o666)


def write_file(target: Target, name: str, content: bytes | pa.Buffer, durable: bool = True) -> None:
    """Write bytes under a name below the target, completely or not at all; the target must exist.

    If a file is not `durable`, a power failure before `sync` may remove it, but never leaves a part of it.
    """
    path = Path(target.root, name)
    with file_errors(f"{target.name}/{name}"), ending.uncut():
        if not target.local:
            with target.fs.open_output_stream(f"{target.root}/{name}") as stream:
                stream.write(content)
            return
        _require_no_link(target, name.rpartition("/")[0])
        temporary, handle = _partial(target.root)
        try:
            with open(handle, "wb") as f:
                f.write(content)
                f.flush()
                os.fsync(f.fileno())
            folder = Path(target.root)
            for part in Path(name).parent.parts:  # a root that has been removed is not made again
                folder /= part
                if not folder.is_dir():
                    folder.mkdir(exist_ok=True)
                    _sync_folder(folder.parent)
            os.replace(temporary, path)
            if durable:
                _sync_folder(path.parent)
        finally:
            with suppress(OSError):
                os.unlink(temporary)


def _partial(root: str) -> tuple[str, int]:
    """A new file in a folder and its open handle; never an existing file or the target of a link."""
    while True:
        path = f"{root}/.{socket.gethostname()}-{os.getpid()}-{next(_COUNT)}{PARTIAL}"
        with suppress(FileExistsError):
            return path, create(path)


def _sync_folder(folder: Path) -> None:
    """Sync the file names in a folder, so that a power failure does not remove them."""
    with suppress(OSError):  # not every file system lets a folder be opened
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _require_no_link(target: Target, name: str) -> None:
    """Raise UserError if a name below a folder is a symbolic link, or its path contains one."""
    for path in itertools.accumulate(name.split("/"), "{}/{}".format) if target.local and name else ():
        if os.path.islink(f"{target.root}/{path}"):
            raise UserError(
                f"{target.name}/{path}: is a symbolic link, which is not followed below a dataset's folder; remove it, or put "
                "there what it points at."
            )


def write_table(target: Target, name: str, table: pa.Table, durable: bool = True) -> None:
    """Write one Parquet file, after a check of its number of rows and its metadata."""
    write_file(target, name, parquet_io.encode_table(table), durable)


def write_json(target: Target, name: str, content: Mapping[str, object]) -> None:
    """Write one JSON file."""
    write_file(target, name, (json.dumps(content, indent=2) + "\n").encode())


def write_files(target: Target, files: Mapping[str, bytes | pa.Buffer]) -> None:
    """Put files that belong together: in a folder of this machine all of them, or none if this is interrupted."""
    temporary = {
        name: f"{Path(name).parent}/.{Path(name).name}-{os.getpid()}" if target.local else name for name in files
    }
    root = Path(target.root)
    with ending.uncut():
        try:
            for name, content in files.items():
                write_file(target, temporary[name], content)
            if target.local:
                with file_errors(target.name):
                    rename_all([(root / temporary[name], root / name) for name in files])
        finally:
            for path in temporary.values() if target.local else ():
                with suppress(OSError):
                    (root / path).unlink(missing_ok=True)


def rename_all(pairs: Iterable[tuple[Path, Path]]) -> None:
    """Rename files that belong together; an interrupt takes effect only afterwards."""
    queue = list(pairs)
    try:
        with ending.uncut():
            while queue:
                os.replace(*queue[0])
                del queue[0]
    except KeyboardInterrupt:
        for temporary, name in queue:
            with suppress(FileNotFoundError):  # it has its name already
                os.replace(temporary, name)
        raise


def sync(target: Target, folders: Iterable[str]) -> None:
    """Sync the names of all files in some folders below the target, so that a power failure does not remove them."""
    for folder in folders if target.local else ():
        _sync_folder(Path(target.root) / folder)


def read_json(target: Target, name: str) -> Json | None:
    """Return the object of a JSON file; None if the file is missing or contains no JSON object."""
    try:
        content = json.loads(read_bytes(target, name) or b"null")
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def read_buffer(target: Target, name: str) -> pa.Buffer | None:
    """Return the content under a name as a buffer; None if there is none. Raises UserError for a link."""
    _require_no_link(target, name)
    with file_errors(f"{target.name}/{name}", "read"):
        if target.fs.get_file_info(f"{target.root}/{name}").type != pafs.FileType.File:
            return None
        with target.fs.open_input_file(f"{target.root}/{name}") as file:
            return file.read_buffer()


def read_bytes(target: Target, name: str) -> bytes | None:
    """Return the content under a name as bytes; None if there is none."""
    content = read_buffer(target, name)
    return None if content is None else content.to_pybytes()


def file_names(target: Target, folder: str = "") -> list[str]:
    """Return the names of all files below a folder of the target, sorted, without those that begin with a dot or _.

    A link counts as a file and is not followed.
    """
    return sorted(file_sizes(target, folder))


def file_sizes(target: Target, folder: str = "") -> dict[str, int]:
    """Return the sizes [bytes] of the files of `file_names`."""
    with file_errors(target.name, "read"):
        base = f"{target.root}/{folder}" if folder else target.root
        if target.local:
            _require_no_link(target, folder)
            by_path = dict(_files(base))
        else:
            infos = target.fs.get_file_info(pafs.FileSelector(base, recursive=True, allow_not_found=True))
            by_path = {i.path: int(i.size or 0) for i in infos if i.is_file}
        by_name = {path[len(target.root) + 1 :]: size for path, size in by_path.items()}
        return {name: size for name, size in by_name.items() if not any(part[0] in "._" for part in name.split("/"))}


def _files(folder: str) -> Iterator[tuple[str, int]]:
    """Yield the paths and sizes of all files below a folder, and of links, which are not followed."""
    try:
        entries = list(os.scandir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _files(entry.path)
        else:
            with suppress(FileNotFoundError):
                yield entry.path, entry.stat(follow_symlinks=False).st_size


def read_footer(target: Target, name: str) -> pq.FileMetaData | None:
    """Return a Parquet file's metadata without its rows; None if they are unreadable. Raises UserError for a link."""
    _require_no_link(target, name)
    try:
        with target.fs.open_input_file(f"{target.root}/{name}") as file:
            return pq.read_metadata(file)
    except (pa.ArrowException, OSError):
        return None


def remove(target: Target, name: str) -> None:
    """Remove a file or a link if it exists; raise UserError if a folder in its path is a link."""
    _require_no_link(target, name.rpartition("/")[0])
    with file_errors(f"{target.name}/{name}"), suppress(FileNotFoundError):
        os.unlink(f"{target.root}/{name}") if target.local else target.fs.delete_file(f"{target.root}/{name}")


def create_folder(target: Target) -> None:
    """Create the target, and remove unfinished files of killed writers."""
    with file_errors(target.name):
        target.fs.create_dir(target.root, recursive=True)
    remove_unfinished(target)


def remove_unfinished(target: Target) -> None:
    """Remove unfinished files of killed writers in a target."""
    with file_errors(target.name):
        for path in unfinished_files(target):
            path.unlink(missing_ok=True)


def unfinished_files(target: Target) -> list[Path]:
    """Return unfinished files whose writers ended: dead processes of this machine, or silent for a day elsewhere."""
    return [p for p in Path(target.root).glob(f".*{PARTIAL}") if _is_abandoned(p)] if target.local else []


def _is_abandoned(path: Path) -> bool:
    match = UNFINISHED.fullmatch(path.name)
    if match and match[1] == socket.gethostname():
        try:
            os.kill(int(match[2]), 0)
        except ProcessLookupError:
            return True
        except (PermissionError, OverflowError):
            return False
    with suppress(OSError):
        return match is not None and time() - path.stat().st_mtime > ABANDONED_AGE
    return False


@contextmanager
def file_errors(where: str, action: str = "written") -> Iterator[None]:
    """Convert an error of a file system to a UserError of one sentence."""
    try:
        yield
    except (OSError, pa.ArrowException) as error:
        if action == "read":
            raise UserError(f"{where}: cannot be read ({_reason(error)}); expected a file that you may read.") from None
        raise UserError(
            f"{where}: cannot be written ({_reason(error)}); every file already written is complete: make room or give "
            "yourself the right to write, and run the same command again to continue, or give another folder with --out."
        ) from None


def _reason(error: BaseException) -> str:
    return str(getattr(error, "strerror", None) or str(error) or type(error).__name__).splitlines()[0].rstrip(".")
