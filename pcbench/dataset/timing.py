"""What a run of a study took."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple


class Cost(NamedTuple):
    """What a run of a study took."""

    runs: int = 0
    compiled: Mapping[Any, float] = MappingProxyType({})  # seconds by program
    planning_seconds: float = 0.0  # of this thread: designs, and the laying out of cells
    computing_seconds: float = 0.0  # of all threads that compute
    writing_seconds: float = 0.0  # of all that write
    closing_seconds: float = 0.0  # of this thread, beside the others
    exact_seconds: float = 0.0  # of what has an exact answer, from planning to files; 0: nothing was made

    @property
    def compile_seconds(self) -> float:
        """Return the seconds that programs took to make."""
        return sum(self.compiled.values())


def added(a: Cost, b: Cost) -> Cost:
    """Return what two runs took together."""
    seconds = (x + y for x, y in zip(a[2:], b[2:], strict=True))
    return Cost(a.runs + b.runs, {**a.compiled, **b.compiled}, *seconds)
