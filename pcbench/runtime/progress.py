"""Progress of long work: what has begun, how many steps are done, what is being done now. Where time goes. No jax."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import NamedTuple, TypeVar


def _ignore(*said: object) -> None:
    """Hear and do nothing."""


class Progress(NamedTuple):
    """Who hears of progress: three functions, each of which may be left out.

    `begin` takes what begins and how many steps it has (None: not known); begun again, the same work has so many more. `step`
    takes how many more are done, `note` what is being done now.
    """

    begin: Callable[[str, int | None], None] = _ignore
    step: Callable[[int], None] = _ignore
    note: Callable[[str], None] = _ignore


SILENT = Progress()
COMPILING = "compiling"  # in a note: how long the rest takes cannot be estimated yet


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
