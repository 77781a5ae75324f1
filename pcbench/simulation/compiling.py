"""Compiled programs of this process, and no more of them than are used. jax keeps them on disk where `process.setup` says."""

import ctypes
from collections.abc import Callable, Hashable
from functools import cache, wraps
from typing import Any

import jax

MOST = 16  # programs that one cache keeps
MAPPINGS = 10_000  # of memory, that these have together: a program has 130 to 5,000, and Linux allows a process 65,530


def bounded(function: Callable[..., Any], static_argnums: int | tuple[int, ...] = ()) -> Callable[..., Any]:
    """Return a function compiled once for each shape and static argument; after `MOST` programs it drops them all."""
    jitted: Any = jax.jit(function, static_argnums=static_argnums)

    @wraps(function)
    def call(*arguments: Any) -> Any:
        if jitted._cache_size() >= MOST:
            jitted.clear_cache()
        return jitted(*arguments)

    call._cache_size = jitted._cache_size  # type: ignore[attr-defined]
    return call


class Programs(dict[Hashable, Any]):
    """The programs that were asked for last, by what they are compiled for, within `MOST` and `MAPPINGS`."""

    made = 0  # so far

    def __init__(self) -> None:
        """Begin with none."""
        super().__init__()
        self.mappings: dict[Hashable, int] = {}  # of each program, as far as it was made within `ask`

    def ask(self, key: Hashable, new: Callable[[], Any]) -> Any:
        """Return the program of a key, made by `new` if there is none."""
        if key in self:
            self[key] = found = self.pop(key)
            return found
        before = _mappings()
        self[key] = found = new()
        self.mappings[key], self.made = _mappings() - before, self.made + 1
        while len(self) > MOST or (len(self) > 1 and sum(self.mappings[each] for each in self) > MAPPINGS):
            oldest = next(iter(self))
            del self[oldest], self.mappings[oldest]
        _release()
        return found


def _release() -> None:
    """Give the memory that a compiler has freed back to the system: glibc keeps it, half of what a long process holds."""
    trim = getattr(_libc(), "malloc_trim", None)
    if trim is not None:
        trim(0)


@cache
def _libc() -> Any:
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
