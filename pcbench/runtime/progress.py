"""Progress of long work: its steps, those completed, the current activity, and the time per activity. No jax."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import NamedTuple, TypeVar


def _ignore(*report: object) -> None:
    """Ignore a report."""


class Progress(NamedTuple):
    """Receivers of progress reports: three functions, each of which may be omitted.

    `begin` receives a label and the number of steps (None: unknown); a second call adds steps. `step` receives the number of
    completed steps. `note` receives the current activity.
    """

    begin: Callable[[str, int | None], None] = _ignore
    step: Callable[[int], None] = _ignore
    note: Callable[[str], None] = _ignore


SILENT = Progress()
COMPILING = "compiling"  # in a note: the remaining time cannot be estimated yet


T = TypeVar("T")


class Stopwatch:
    """Seconds per activity."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, activity: str) -> Iterator[None]:
        """Measure the time of a `with` block."""
        start = perf_counter()
        try:
            yield
        finally:
            self.seconds[activity] += perf_counter() - start

    def measure_each(self, activity: str, values: Iterable[T]) -> Iterator[T]:
        """Yield items, and measure the time until each arrives."""
        iterator = iter(values)
        while True:
            with self(activity):
                try:
                    value = next(iterator)
                except StopIteration:
                    return
            yield value
