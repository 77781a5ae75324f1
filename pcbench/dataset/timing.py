"""The time and memory that a run of a study took, and an estimate of the time of a call before it starts."""

from collections.abc import Mapping
from time import perf_counter
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pcbench.engine import runner

FIRST, ENOUGH, SHORT = 4, 2.0, 1.0  # [ticks], [s], [s]; see `seconds`


def seconds(program: runner.Program, job: runner.Job) -> float:
    """Return the estimated time [s] of a call, from calls that end early, each after twice as many ticks.

    They stop if the last one took `ENOUGH` seconds, or ran a sixteenth of the ticks, or if a call is clearly `SHORT`.
    The first call of all may include the start of the program, so its time alone is no estimate: a second call follows.
    The first ticks are faster than later ones, because no measurement has arrived, so this is a lower estimate. The
    reference engine cannot end a call early, and the result is 0.
    """
    if program.layout.by_definition:
        return 0.0
    n_ticks, previous = int(job.problem.windows[-1, 1]), (0, 0.0)
    end, rest_seconds = FIRST, 0.0
    while end <= n_ticks // 16 and (previous[1] < ENOUGH or previous[0] <= FIRST):
        windows = np.minimum(job.problem.windows, end)
        windows[-1] = end, end + 1
        start = perf_counter()
        for _ in runner.serial(program, [job._replace(problem=job.problem._replace(windows=windows))]):
            duration = perf_counter() - start
        rest_seconds = max(duration - previous[1], 0.0) / (end - previous[0]) * (n_ticks - end)
        if duration * n_ticks / end < SHORT:
            return duration + rest_seconds
        previous, end = (end, duration), 2 * end
    return previous[1] + rest_seconds


class Cost(NamedTuple):
    """The time and memory that a run of a study took."""

    runs: int = 0
    compiled: Mapping[tuple[str, int], float] = MappingProxyType({})  # seconds by program: which one, of which process
    planning_seconds: float = 0.0  # of this thread: designs, and the laying out of cells
    computing_seconds: float = 0.0  # of all threads that compute
    writing_seconds: float = 0.0  # of all that write
    exact_seconds: float = 0.0  # of exact results, from planning to files; 0: they existed

    @property
    def compile_seconds(self) -> float:
        """Return the time [s] of compilations."""
        return sum(self.compiled.values())


def add_costs(a: Cost, b: Cost) -> Cost:
    """Return the sum of the costs of two runs."""
    seconds = (x + y for x, y in zip(a[2:], b[2:], strict=True))
    return Cost(a.runs + b.runs, {**a.compiled, **b.compiled}, *seconds)
