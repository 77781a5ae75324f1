"""Timing in turns: every row once, then every row again, so that the machine's drift meets all alike.

A row on one core has every thread of the process held to that core, another one each turn, where the system can do so; a
row on more has none held.
"""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import perf_counter, process_time, sleep
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Row(NamedTuple):
    """One way to do the work."""

    what: str
    cores: int
    lanes: int  # side by side
    runs: int  # in a turn
    work: Callable[[], Any]  # one turn
    compile_seconds: float | None


class Timed(NamedTuple):
    """What the turns of all rows took, [rows, turns]."""

    wall: NDArray[np.float64]  # s
    cpu: NDArray[np.float64]  # s, of all threads


def hold(cores: list[int]) -> None:
    """Hold every thread of this process to these cores, where the system can; threads made later inherit it."""
    threads = Path("/proc/self/task")
    if hasattr(os, "sched_setaffinity"):
        for thread in [int(p.name) for p in threads.iterdir()] if threads.exists() else [0]:
            with suppress(ProcessLookupError):  # a thread that has just ended
                os.sched_setaffinity(thread, cores)


def take(rows: list[Row], turns: int) -> Timed:
    """Give every row its turns."""
    every = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    timed = Timed(np.zeros((len(rows), turns)), np.zeros((len(rows), turns)))
    for turn in range(turns):
        for i, row in enumerate(rows):
            hold(every if row.cores > 1 else [every[turn % len(every)]])
            sleep(0.02)  # threads that still spin after the row before go to sleep
            wall, cpu = perf_counter(), process_time()
            row.work()
            timed.wall[i, turn], timed.cpu[i, turn] = perf_counter() - wall, process_time() - cpu
    hold(every)
    return timed
