"""How long a call takes, estimated before a study is begun."""

from time import perf_counter

import numpy as np

from pcbench.engine import runner

FIRST, ENOUGH, SHORT = 4, 2.0, 1.0  # ticks, [s], [s]: of the calls that are timed


def seconds(made: runner.Program, job: runner.Job) -> float:
    """Return about how many seconds a call takes, from calls that end early, each after twice as many ticks.

    They stop once the last took `ENOUGH` seconds, or a sixteenth of the ticks are done, or a call is clearly `SHORT`. The first
    ticks cost less than others, as nothing has arrived yet: it is a lower estimate. 0 if all observers are lifted, or the
    program is the definition, whose calls do not end early.
    """
    if all(way in ("lifted", "defined") for way in made.ways.values()):
        return 0.0
    many, before = int(job.problem.windows[-1, 1]), (0, 0.0)
    end, rest = FIRST, 0.0
    while end <= many // 16 and before[1] < ENOUGH:
        windows = np.minimum(job.problem.windows, end)
        windows[-1] = end, end + 1
        start = perf_counter()
        for _ in runner.serial(made, [job._replace(problem=job.problem._replace(windows=windows))]):
            took = perf_counter() - start
        rest = max(took - before[1], 0.0) / (end - before[0]) * (many - end)
        if took * many / end < SHORT:
            return took + rest
        before, end = (end, took), 2 * end
    return before[1] + rest
