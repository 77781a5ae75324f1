"""Feed a recording to observers tick by tick: samples (`recordings.windows`), inputs held until the next row, truth if known.

Rows of inputs and truth apply from the nearest tick on; of several at one tick the last one applies. Truth may lack states.
Each observer has its own program, state and thread. So its estimates do not depend on other observers, and with enough cores
several take as long as the slowest.
"""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from itertools import chain
from typing import NamedTuple

import jax
import numpy as np
import pandas as pd

from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.playback import step_block
from pcbench.playback.setup import Playback, PlaybackSetup
from pcbench.playback.step_block import Score, TickOutputs
from pcbench.recordings.log import Floats, Ints, Table
from pcbench.recordings.times import require_forward
from pcbench.recordings.windows import Window, blocks, cut, window
from pcbench.runtime import thread_pools
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, InputWindow, Layout


class Part(NamedTuple):
    """K ticks of a recording, from tick `first` on; m inputs, n + s signals."""

    first: int
    window: Window
    inputs: Floats  # [back + K, m] from tick first - back on; 0 before tick 0
    truth: Floats  # [K, n + s] NaN: unknown; [K, 0]: no truth


def parts(playback: Playback, setup: PlaybackSetup, signals: Sequence[str]) -> Iterator[Part]:
    """Yield a recording in parts of fixed length, with `back` ticks of inputs before each, and the truth of `signals`."""
    inputs = at_ticks(
        playback, playback.log.inputs, "inputs", playback.log.inputs.names if playback.log.inputs else [""] * setup.m
    )
    truth = at_ticks(playback, playback.log.truth, "truth", signals)
    before, arrived = np.zeros((setup.back, setup.m)), 0
    for block in blocks(playback.log, playback.survey, playback.clock, playback.length, playback.last_tick):
        samples, arrived = window(block, len(playback.log.channels), setup.slots, arrived, setup.variances)
        rows = next(inputs)
        exists = ~np.isnan(rows).all(1) if setup.m else np.zeros(playback.length, bool)
        newest = np.maximum.accumulate(np.where(exists, np.arange(playback.length), -1))
        held_inputs = np.where((newest >= 0)[:, None], rows[np.maximum(newest, 0)], before[-1])
        part_inputs = np.concatenate([before, held_inputs])
        yield Part(block.first, samples, part_inputs, next(truth))
        before = part_inputs[len(part_inputs) - setup.back :]


def at_ticks(playback: Playback, table: Table | None, kind: str, names: Sequence[str]) -> Iterator[Floats]:
    """Yield columns of a table as [length, columns] for every block of ticks, NaN without a row."""
    where = f"{playback.log.name}: {kind}"
    missing = [name for name in names if table and name not in table.names]
    if table and missing and (kind == "inputs" or len(missing) == len(names)):
        raise UserError(
            f"{where}: got the columns {', '.join(table.names)}, expected {', '.join(names)}; write {missing[0]}."
        )

    def rows_in_ticks() -> Iterator[pd.DataFrame]:
        yield pd.DataFrame(np.zeros((0, len(names))), np.zeros(0, int), list(names))
        if table is None or not names:
            return
        before = -np.inf
        for rows in table.read():
            if not len(rows.t):
                continue
            require_forward(where, before, rows)
            before = float(rows.t[-1])
            tick = playback.clock.ticks(rows.t)
            yield pd.DataFrame(rows.values, tick, list(table.names)).reindex(columns=list(names))[tick >= 0]

    for first, rows in cut(rows_in_ticks(), playback.length, playback.last_tick):
        out = np.full((playback.length, len(names)), np.nan)
        rows = rows.groupby(level=0).last()  # the last value of each column at a tick
        out[rows.index - first] = rows
        yield out


class Runner(NamedTuple):
    """One observer during a replay."""

    label: str
    layout: Layout
    problem: GridPointParams
    state: Run
    score: Score | None


def init_runners(setup: PlaybackSetup, with_score: bool, seed: int) -> list[Runner]:
    """Return every observer before tick 0."""
    out = []
    for label, observer in setup.layout.observers:
        layout = setup.layout._replace(observers=((label, observer),), consistency=True)
        problem = setup.problem._replace(gains={label: setup.problem.gains[label]})
        state, score = step_block.jit_step_block()[0](layout, problem, with_score, np.asarray(seed))
        state = state if setup.variances is None else step_block.with_variances(state)
        out.append(Runner(label, layout, problem, state, score))
    return out


def through(
    runners: list[Runner], recording_parts: Iterable[Part], back: int, ends: Ints
) -> Iterator[tuple[Part, dict[str, TickOutputs]]]:
    """Run observers through a recording; yield each part with their outputs while the next one is computed.

    `runners` are updated in place. `back` is as in `PlaybackSetup`, `ends` as in `step_block.run_block`.
    """

    def advance(o: Runner, part: Part) -> tuple[Runner, TickOutputs]:
        problem = o.problem._replace(inputs=InputWindow(part.inputs, np.asarray(part.first - back)))
        ticks = part.first + np.arange(len(part.window.event))
        state, score, outputs = step_block.jit_step_block()[1](
            o.layout, problem, o.state, o.score, ticks, part.window, part.truth, ends
        )
        return o._replace(state=state, score=score), jax.block_until_ready(outputs)

    previous: Part | None = None
    work: list[Future[tuple[Runner, TickOutputs]]] = []
    with thread_pools.pool(min(len(runners), runner.cores())) as threads:
        for part in chain(recording_parts, [None]):
            results = [future.result() for future in work]
            runners[:] = [o for o, _ in results] or runners
            work = [threads.submit(runner.in_float64, advance, o, part) for o in runners if part]
            if previous:
                yield previous, {o.label: outputs for o, outputs in results}
            previous = part
