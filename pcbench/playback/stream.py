"""What a log feeds to observers at every tick: samples (`recordings.windows`), inputs held until the next row, truth if known.

Rows of inputs and truth count from the nearest tick on; of several at one tick the last one does.

Observers of a log side by side: each has a program and a state of its own, and goes through a part of the log in a thread.

So what one estimates does not depend on who else runs, and where there are cores several take as long as the dearest of them.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from itertools import chain
from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.playback import step_block
from pcbench.recordings.events import Clocked, stretches
from pcbench.recordings.log import Floats, Ints, Log, Rows, Table, require_forward
from pcbench.recordings.survey import Survey
from pcbench.recordings.ticks import ticks
from pcbench.recordings.windows import Room, Tally, Window, tally, window
from pcbench.runtime import thread_pools
from pcbench.simulation.types import GridPointParams, InputWindow, Layout, State


class Part(NamedTuple):
    """K ticks of a log, from tick `first` on; m inputs, n + s signals."""

    first: int
    window: Window
    inputs: Floats  # [back + K, m] from tick first - back on; those before tick 0 are 0
    truth: Floats  # [K, n + s] NaN where it is not known; [K, 0]: of none


def room(log: Log, found: Survey, clock: Clocked, length: int, last: int) -> Room:
    """Return what a log needs room for; it is read once."""
    latest = int(np.ceil(max((s.delays.most for s in found.channels.values()), default=0.0) / clock.dt)) + 1
    so_far = Tally()
    for stretch in stretches(log, found, clock, length, last):
        so_far = tally(so_far, stretch, max(latest, 0))
    return so_far.room


def parts(
    log: Log, found: Survey, clock: Clocked, length: int, last: int, slots: int, back: int, m: int, signals: int
) -> Iterator[Part]:
    """Yield a log in parts of `length` ticks, with `back` ticks of inputs before each; `signals` 0: no truth is asked for."""
    inputs = held(log.inputs, f"{log.name}: inputs", clock, m, length, last)
    truth = at_ticks(log.truth, f"{log.name}: truth", clock, signals, length, last)
    before, arrived = np.zeros((back, m)), 0
    for stretch in stretches(log, found, clock, length, last):
        laid, arrived = window(stretch, len(log.channels), slots, arrived)
        whole = np.concatenate([before, next(inputs)])
        yield Part(stretch.first, laid, whole, next(truth))
        before = whole[len(whole) - back :]


def held(table: Table | None, where: str, clock: Clocked, m: int, length: int, last: int) -> Iterator[Floats]:
    """Yield the inputs [length, m] of every stretch of ticks: those of the last row before, 0 before the first."""
    value = np.zeros(m)
    for rows in at_ticks(table, where, clock, m, length, last):
        there = ~np.isnan(rows).all(1) if m else np.zeros(length, bool)
        newest = np.maximum.accumulate(np.where(there, np.arange(length), -1))
        out = np.where((newest >= 0)[:, None], rows[np.maximum(newest, 0)], value)
        value = out[-1]
        yield out


def at_ticks(table: Table | None, where: str, clock: Clocked, many: int, length: int, last: int) -> Iterator[Floats]:
    """Yield the rows of a table as [length, many] of every stretch of ticks, NaN where there is none."""
    read = _in_ticks(table, where, clock, many) if table and many else iter(())
    waiting: list[Rows] = []
    for first in range(0, last + 1, length):
        out = np.full((length, many), np.nan)
        while not waiting or waiting[-1].t[-1] < first + length:
            more = next(read, None)
            if more is None:
                break
            waiting.append(more)
        for rows in waiting:
            here = (rows.t >= first) & (rows.t < first + length)
            out[rows.t[here].astype(int) - first] = rows.values[here]
        waiting = [rows for rows in waiting if rows.t[-1] >= first + length]
        yield out


def _in_ticks(table: Table, where: str, clock: Clocked, many: int) -> Iterator[Rows]:
    before = -np.inf
    for rows in table.read():
        if not len(rows.t):
            continue
        require_forward(where, before, rows)
        before = float(rows.t[-1])
        bad = ~np.isfinite(rows.values)
        if bad.any():
            i, j = (int(place[0]) for place in np.nonzero(bad))
            raise UserError(
                f"{where}: row {rows.row[i]}: got {rows.values[i, j]} as {table.names[j]}, expected a finite number; mend or "
                "leave out that row."
            )
        yield rows._replace(t=ticks(rows.t, clock.start, clock.dt)[0].astype(float))


def require_columns(table: Table | None, names: list[str], where: str) -> list[int]:
    """Return the places of columns in a table; raise UserError where one is missing."""
    there = table.names if table else ()
    missing = [name for name in names if name not in there]
    if missing:
        raise UserError(
            f"{where}: got the columns {', '.join(there) or 'none'}, expected {', '.join(names)}; write {missing[0]}."
        )
    return [there.index(name) for name in names]


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
