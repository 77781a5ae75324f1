"""A limited cache of compiled programs in this process. jax caches them on disk if `config.setup` was called."""

import ctypes
from collections.abc import Callable, Hashable, Iterator
from functools import cache, wraps
from threading import Lock, Semaphore
from typing import Any, Generic, TypeVar

import jax

R = TypeVar("R")  # result of a function; a program
MOST = 16  # programs in one cache
AT_ONCE = 2  # programs compiled in parallel: a compiler may take gigabytes for one
MAPPINGS = 10_000  # memory mappings of all programs: one has 130 to 5,000, and Linux allows a process 65,530


def jit_with_limit(function: Callable[..., R], static_argnums: int | tuple[int, ...] = ()) -> Callable[..., R]:
    """Return a function compiled once for each shape and static argument; after `MOST` programs the cache is cleared."""
    compiled: Any = jax.jit(function, static_argnums=static_argnums)

    @wraps(function)
    def call(*arguments: object) -> R:
        if compiled._cache_size() >= MOST:
            compiled.clear_cache()
        out: R = compiled(*arguments)
        return out

    call._cache_size = compiled._cache_size  # type: ignore[attr-defined]
    return call


class CacheEntry(Generic[R]):
    """A program, or the placeholder of one that another thread is compiling while it holds the lock."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.program: R | None = None
        self.mappings = 0  # of memory, added while `ask` compiled it


class Programs(Generic[R]):
    """The most recently used programs by key, within `MOST` and `MAPPINGS`.

    Up to `AT_ONCE` threads compile different programs in parallel. A thread waits for a program that is being compiled.
    Iteration yields the keys, the most recently used last.
    """

    def __init__(self) -> None:
        self.compilations = 0  # number of programs compiled so far
        self._entries: dict[Hashable, CacheEntry[R]] = {}
        self._lock, self._room = Lock(), Semaphore(AT_ONCE)

    def __iter__(self) -> Iterator[Hashable]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def ask(self, key: Hashable, new: Callable[[], R]) -> R:
        """Return the program of a key, compiled by `new` if it is not cached."""
        with self._lock:
            self._entries[key] = one = self._entries.pop(key, None) or CacheEntry()
        with one.lock:
            if one.program is None:
                with self._room:
                    mappings = _mappings()
                    one.program = new()
                    one.mappings = _mappings() - mappings
                with self._lock:
                    self._entries[key] = one  # it may have been evicted while it was compiled
                    self.compilations += 1
                    while len(self) > MOST or (
                        len(self) > 1 and sum(o.mappings for o in self._entries.values()) > MAPPINGS
                    ):
                        del self._entries[next(iter(self))]  # the least recently used
                _release()
            return one.program


def _release() -> None:
    """Return the memory that a compiler has freed to the system; glibc keeps it, half of the size of a long process."""
    trim = getattr(_libc(), "malloc_trim", None)
    if trim is not None:
        trim(0)


@cache
def _libc() -> ctypes.CDLL | None:
    """Return the C library of this process; None if it has no `malloc_trim`, as on Windows."""
    try:
        return ctypes.CDLL(None)
    except (OSError, TypeError):
        return None


def _mappings() -> int:
    """Return how many memory mappings this process has; 0 if unknown."""
    try:
        with open("/proc/self/maps", "rb") as lines:
            return sum(1 for _ in lines)
    except OSError:
        return 0
