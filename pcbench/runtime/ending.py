"""End the process from any thread between file writes: no file is truncated, and none is begun after that. No jax."""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_CHANGE = threading.Condition()
_INSIDE: list[int] = []  # threads inside an `uncut` block, once per block
_LEAVING: list[int] = []  # the thread that ends the process
_CLEANING: list[Callable[[], object]] = []  # functions that remove temporary files of unfinished blocks
LONGEST = 30.0  # [s] longest wait for such a block


@contextmanager
def uncut() -> Iterator[None]:
    """Have the process end before or after this block, not inside it, for a block that writes files or ends other processes."""
    me = threading.get_ident()
    with _CHANGE:
        while _LEAVING and _LEAVING[0] != me and me not in _INSIDE:
            _CHANGE.wait()  # until the process ends
        _INSIDE.append(me)
    try:
        yield
    finally:
        with _CHANGE:
            _INSIDE.remove(me)
            _CHANGE.notify_all()


@contextmanager
def clean_on_exit(clean: Callable[[], object]) -> Iterator[None]:
    """Have `clean` called if the process ends inside this block."""
    _CLEANING.append(clean)
    try:
        yield
    finally:
        _CLEANING.remove(clean)


@contextmanager
def temporary_folder() -> Iterator[str]:
    """Yield a folder that is removed after this block, or if the process ends inside it."""
    from shutil import rmtree
    from tempfile import TemporaryDirectory  # imported late: the command line starts faster

    with TemporaryDirectory(prefix="pcbench-") as folder, clean_on_exit(lambda: rmtree(folder, ignore_errors=True)):
        yield folder


def begin() -> bool:
    """Return whether the calling thread ends the process: the first caller does."""
    with _CHANGE:
        if not _LEAVING:
            _LEAVING.append(threading.get_ident())
        return _LEAVING[0] == threading.get_ident()


def end(code: int) -> None:
    """End the process with an exit code once no other thread is inside an `uncut` block; compiled calls are not awaited."""
    me = threading.get_ident()
    with _CHANGE:
        _CHANGE.wait_for(lambda: all(thread == me for thread in _INSIDE), LONGEST)
    for clean in reversed(_CLEANING):
        with suppress(Exception):
            clean()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
