"""Many runs at once: calls of one compiled width, several at a time.

A *job* is one cell's `GridPointParams` with up to `width` seeds, padded to that: a run has the same bits alone and in any
block. A program computes on one thread of one device, several calls at a time, so nothing beside it changes its bits.
"""

import itertools
import operator
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import PyTree

from pcbench.engine import event_loop
from pcbench.errors import UserError
from pcbench.runtime import config, program_cache, program_store, thread_pools
from pcbench.simulation.innovation_stats import InnovationStats, Squares
from pcbench.simulation.metrics import ControlCost, ErrorSums, IntervalSums, SettlingState
from pcbench.simulation.simulate_runs import simulate_runs
from pcbench.simulation.types import GridPointParams, Layout, RunSums

WIDTH = 1024  # lanes a call
DEFINITION = 64  # of the definition
EXPENSIVE = 8  # of the definition with an observer whose runs are expensive
NARROW = (64, 256)  # of cells with few runs: 64 lanes take a quarter of the time of 1024
HEAVY = 256  # of a plant whose ticks cost much: on the arm 1024 lanes are no faster a lane, and few seeds fill them
# types of what a program returns
RETURNED = (RunSums, ErrorSums, SettlingState, IntervalSums, ControlCost, Squares, InnovationStats)


def vector_width() -> str:
    """Return how many bits a vector of this processor has; of one without 512, wider ones take twice as long."""
    try:
        return "512" if " avx512f" in Path("/proc/cpuinfo").read_text() else "256"
    except OSError:  # not on Linux
        return "256"


OPTIONS: dict[str, str | bool] = {  # of the compiler, for a processor
    "xla_cpu_multi_thread_eigen": False,  # small products shared out among threads: 3 times slower, other bits
    "xla_cpu_prefer_vector_width": vector_width(),  # where it has 512: the arm takes 0.77 of the time that 256 bits take
}


class Job(NamedTuple):
    """The runs of one cell that are simulated in one call."""

    problem: GridPointParams
    root_seed: int
    seeds: np.ndarray  # at most `width`
    schedules: PyTree = None  # of each seed, [seeds] first, where the definition computes runs whose sampling is random


class Program(NamedTuple):
    """A compiled call and what it took to make."""

    layout: Layout
    call: Any  # (problem, root seed, seeds [L], schedules) -> RunSums with arrays [..., L]
    device: jax.Device
    width: int
    compile_seconds: float
    number: int = 0  # of this process: the first program, the second ...
    memory: int = 0  # bytes a call takes while it computes, as the compiler says; 0: it does not say


def devices(count: int | None = None) -> list[PyTree]:
    """Return the device that each of the calls at a time runs on: one a core, or one an accelerator; `count` of them."""
    found = jax.devices()
    if found[0].platform == "cpu":
        return [found[0]] * (count or cores())
    return found[:count]


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def program(layout: Layout, job: Job, device: jax.Device | None = None) -> Program:
    """Compile the call for jobs shaped like `job` on a device (default the first); once for each shape.

    Raises UserError where jax would compute in float32.
    """
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise UserError(
            "simulation: got float32 (jax_enable_x64 is off), expected float64: float32 rounds at 1e-7 of a signal, which is "
            "the size of errors compared here; call pcbench.setup(), or run inside jax.enable_x64(True)."
        )
    leaves, tree = jax.tree.flatten(arguments(job, layout.width))
    made_for = layout, device or jax.devices()[0], tree, tuple((np.shape(a), a.dtype) for a in leaves)
    return _PROGRAMS.ask(made_for, lambda: _compile_program(*made_for))


_PROGRAMS: program_cache.Programs[Program] = program_cache.Programs()
_NUMBERS = itertools.count(1)


def _compile_program(layout: Layout, device: jax.Device, tree: PyTree, shapes: tuple[PyTree, ...]) -> Program:
    sharding = jax.sharding.SingleDeviceSharding(device)
    given = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(s, d, sharding=sharding) for s, d in shapes])
    options, start = OPTIONS if device.platform == "cpu" else None, perf_counter()

    def simulate(p: GridPointParams, root_seed: Array, seeds: Array, schedules: PyTree) -> RunSums:
        if layout.defined:
            return simulate_runs(layout, p, root_seed, seeds, schedules)
        return event_loop.simulate(layout, p, root_seed, seeds)

    call = program_store.compile_program(simulate, layout, given, options, RETURNED)
    return Program(
        layout=layout,
        call=call,
        device=device,
        width=layout.width,
        compile_seconds=perf_counter() - start,
        number=next(_NUMBERS),
        memory=_memory(call),
    )


def _memory(call: Any) -> int:
    """What a call works with, and three times what it takes and leaves: of this one, of the next, of what is read."""
    try:
        m = call.memory_analysis()
        return int(m.temp_size_in_bytes + 3 * (m.argument_size_in_bytes + m.output_size_in_bytes))
    except (AttributeError, NotImplementedError, RuntimeError):
        return 0


def compilations() -> int:
    """Return how many programs this process has traced and compiled."""
    return _PROGRAMS.made


def arguments(job: Job, width: int) -> tuple[GridPointParams, PyTree, PyTree, PyTree]:
    """Return what a call takes: arrays, with a short list of seeds padded by repeating it."""
    which = np.resize(np.arange(len(job.seeds)), width)
    schedules = jax.tree.map(lambda a: a[which], job.schedules)
    return jax.tree.map(np.asarray, job.problem), np.asarray(job.root_seed), job.seeds[which], schedules


def serial(made: Program, jobs: Iterable[Job]) -> Iterator[tuple[Job, RunSums]]:
    """Simulate jobs one after another; yield each with what it left, as NumPy arrays [..., L].

    The next call is handed to the device before the last one's results are read.
    """
    waiting: list[tuple[Job, PyTree]] = []
    for job in jobs:
        given = arguments(job, made.width)
        if job.schedules is not None:  # they have other shapes, where more arrives at a tick
            made = program(made.layout, job, made.device)
        waiting.append((job, made.call(*given)))
        if len(waiting) > 1:
            yield _read(*waiting.pop(0))
    for job, out in waiting:
        yield _read(job, out)


def run(layout: Layout, jobs: list[Job], count: int | None = None) -> Iterator[tuple[Job, RunSums]]:
    """Simulate jobs of one shape, `count` at a time (default: all cores or accelerators); yield them in order."""
    at_once = devices(count)
    with thread_pools.pool(len(at_once)) as threads:
        programs = [program(layout, jobs[0], device) for device in at_once]
        waiting = []
        for i, job in enumerate(jobs):
            made = programs[i % len(programs)]
            waiting.append(threads.submit(in_float64, next, serial(made, [job])))
            if len(waiting) > 2 * len(at_once):
                yield waiting.pop(0).result()
        for future in waiting:
            yield future.result()


def in_float64(function: Any, *arguments: PyTree) -> PyTree:
    """Call a function with float64 on: jax keeps that switch for each thread."""
    with config.float64():
        return function(*arguments)


def _read(job: Job, out: RunSums) -> tuple[Job, RunSums]:
    mine = (..., slice(len(job.seeds)))
    return job, jax.tree.map(operator.itemgetter(mine), jax.tree.map(np.asarray, out))
