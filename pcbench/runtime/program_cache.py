"""Compiled programs of this process, and no more of them than are used. jax keeps them on disk where `config.setup` says."""

import ctypes
from collections.abc import Callable, Hashable, Iterator
from functools import cache, wraps
from threading import Lock, Semaphore
from typing import Any, Generic, TypeVar

import jax

R = TypeVar("R")  # what a function returns; a program
MOST = 16  # programs that one cache keeps
AT_ONCE = 2  # programs that are made side by side: a compiler may take gigabytes for one
MAPPINGS = 10_000  # of memory, that these have together: a program has 130 to 5,000, and Linux allows a process 65,530


def jit_with_limit(function: Callable[..., R], static_argnums: int | tuple[int, ...] = ()) -> Callable[..., R]:
    """Return a function compiled once for each shape and static argument; after `MOST` programs it drops them all."""
    jitted: Any = jax.jit(function, static_argnums=static_argnums)

    @wraps(function)
    def call(*arguments: object) -> R:
        if jitted._cache_size() >= MOST:
            jitted.clear_cache()
        out: R = jitted(*arguments)
        return out

    call._cache_size = jitted._cache_size  # type: ignore[attr-defined]
    return call


class CacheEntry(Generic[R]):
    """A program, or the place of one that is being made by the thread that holds its lock."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.program: R | None = None
        self.mappings = 0  # of memory, as far as it was made within `ask`


class Programs(Generic[R]):
    """The programs that were asked for last, by what they are compiled for, within `MOST` and `MAPPINGS`.

    Threads that ask for different ones make `AT_ONCE` of them side by side; who asks for one that is being made waits for it.
    It iterates over what programs are compiled for, the one that was asked for last at the end.
    """

    def __init__(self) -> None:
        self.made = 0  # so far
        self._kept: dict[Hashable, CacheEntry[R]] = {}
        self._lock, self._room = Lock(), Semaphore(AT_ONCE)

    def __iter__(self) -> Iterator[Hashable]:
        return iter(self._kept)

    def __len__(self) -> int:
        return len(self._kept)

    def ask(self, key: Hashable, new: Callable[[], R]) -> R:
        """Return the program of a key, made by `new` if there is none."""
        with self._lock:
            self._kept[key] = one = self._kept.pop(key, None) or CacheEntry()
        with one.lock:
            if one.program is None:
                with self._room:
                    before = _mappings()
                    one.program = new()
                    one.mappings = _mappings() - before
                with self._lock:
                    self._kept[key], self.made = one, self.made + 1  # it may have been dropped while it was made
                    while len(self) > MOST or (
                        len(self) > 1 and sum(o.mappings for o in self._kept.values()) > MAPPINGS
                    ):
                        del self._kept[next(iter(self))]  # the oldest
                _release()
            return one.program


def _release() -> None:
    """Give the memory that a compiler has freed back to the system: glibc keeps it, half of what a long process holds."""
    trim = getattr(_libc(), "malloc_trim", None)
    if trim is not None:
        trim(0)


@cache
def _libc() -> ctypes.CDLL | None:
    """The C library of this process; None where it has none that can be asked, as on Windows."""
    try:
        return ctypes.CDLL(None)
    except (OSError, TypeError):
        return None


def _mappings() -> int:
    """Return how many memory mappings this process has; 0 where the system does not say."""
    try:
        with open("/proc/self/maps", "rb") as lines:
            return sum(1 for _ in lines)
    except OSError:
        return 0
