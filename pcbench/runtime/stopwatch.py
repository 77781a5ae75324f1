"""Where the time of one thread goes. No jax."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TypeVar

T = TypeVar("T")


class Stopwatch:
    """Seconds by what they were spent on."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, what: str) -> Iterator[None]:
        """Count the time until this is left."""
        start = perf_counter()
        try:
            yield
        finally:
            self.seconds[what] += perf_counter() - start

    def each(self, what: str, things: Iterable[T]) -> Iterator[T]:
        """Yield things, and count the time that they take to come."""
        left = iter(things)
        while True:
            with self(what):
                try:
                    thing = next(left)
                except StopIteration:
                    return
            yield thing
