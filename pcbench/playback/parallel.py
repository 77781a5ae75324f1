"""Observers of a log side by side: each has a program and a state of its own, and goes through a part of the log in a thread.

So what one estimates does not depend on who else runs, and where there are cores several take as long as the dearest of them.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from itertools import chain
from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.engine import runner
from pcbench.playback import step_block
from pcbench.playback.stream import Part
from pcbench.recordings.log import Ints
from pcbench.runtime import thread_pools
from pcbench.simulation.types import GridPointParams, InputWindow, Layout, State


class Alone(NamedTuple):
    """One observer on its way through a log."""

    layout: Layout
    problem: GridPointParams
    state: State
    score: Any  # stretch.Score; (): truth is not asked for


Done = tuple[Alone, step_block.Read]


def begun(layout: Layout, p: GridPointParams, slots: int, scored: bool, seed: int) -> list[Alone]:
    """Return every observer before tick 0."""
    begin, out = step_block.compiled()[0], []
    for label, observer in layout.observers:
        mine, problem = layout._replace(observers=((label, observer),)), p._replace(gains={label: p.gains[label]})
        out.append(Alone(mine, problem, *begin(mine, problem, slots, scored, np.asarray(seed))))
    return out


def through(every: list[Alone], parts: Iterable[Part], back: int, ends: Ints) -> Iterator[tuple[Part, step_block.Read]]:
    """Take observers through a log, and yield each part with what was seen in it while they go through the next.

    At the end `every` is at the end of the log; `back` and `ends` are as in `stream.parts` and `step_block.run`.
    """
    before: Part | None = None
    work: list[Future[Done]] = []
    with thread_pools.pool(min(len(every), runner.cores())) as threads:
        for part in chain(parts, [None]):
            done = [each.result() for each in work]
            every[:] = [o for o, _ in done] or every
            work = [threads.submit(runner.in_float64, _part, o, part, back, ends) for o in every if part]
            if before:
                yield before, _together([read for _, read in done])
            before = part


def _part(o: Alone, part: Part, back: int, ends: Ints) -> Done:
    inputs, ticks = (
        InputWindow(part.inputs, np.asarray(part.first - back)),
        part.first + np.arange(len(part.window.event)),
    )
    problem = o.problem._replace(inputs=inputs)
    state, score, read = step_block.compiled()[1](
        o.layout, problem, o.state, o.score, ticks, part.window, part.truth, ends
    )
    return o._replace(state=state, score=score), jax.block_until_ready(read)


def _together(reads: list[step_block.Read]) -> step_block.Read:
    return step_block.Read(
        *({k: v for read in reads for k, v in getattr(read, what).items()} for what in step_block.Read._fields)
    )


def score(every: list[Alone]) -> Any:
    """Return the score of all; (): truth is not asked for."""
    found, labels = [o.score for o in every], ("streams", "watches", "final")
    if not found[0]:
        return ()
    return found[0]._replace(**{what: {k: v for s in found for k, v in getattr(s, what).items()} for what in labels})
