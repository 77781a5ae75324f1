"""Run many simulations: compiled calls of one width, several at a time.

A *job* is one grid point's `GridPointParams` with up to `width` seeds, padded to the width. A run has the same bits alone and
in any block. A program computes on one thread of one device, and several calls run at a time. So other work does not change its
bits.
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

WIDTH = 1024  # lanes per call
DEFINITION_WIDTH = 64  # lanes of the definition
EXPENSIVE_WIDTH = 8  # lanes of the definition with an expensive observer
NARROW_WIDTHS = (64, 256)  # for grid points with few runs: 64 lanes take a quarter of the time of 1024
HEAVY_WIDTH = 256  # for a plant with expensive ticks: on the arm 1024 lanes are not faster per lane
# types of a program's results
RESULT_TYPES = (RunSums, ErrorSums, SettlingState, IntervalSums, ControlCost, Squares, InnovationStats)


def vector_width() -> str:
    """Return the vector width of this processor in bits; without 512-bit vectors, requesting them doubles the time."""
    try:
        return "512" if " avx512f" in Path("/proc/cpuinfo").read_text() else "256"
    except OSError:  # not on Linux
        return "256"


OPTIONS: dict[str, str | bool] = {  # compiler options for a CPU
    "xla_cpu_multi_thread_eigen": False,  # multithreaded small products are 3 times slower and change bits
    # else kernels of expensive ticks are split over all threads, and waiting for them doubles the time of a tick
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
    "xla_cpu_prefer_vector_width": vector_width(),  # with 512 bits, the arm takes 0.77 of the time with 256 bits
}


class Job(NamedTuple):
    """The runs of one grid point that are simulated in one call."""

    problem: GridPointParams
    root_seed: int
    seeds: np.ndarray  # at most `width`
    schedules: PyTree = None  # one per seed, [seeds] first, if the definition simulates random sampling


class Program(NamedTuple):
    """A compiled call and its compilation data."""

    layout: Layout
    call: Any  # (problem, root seed, seeds [L], schedules) -> RunSums with arrays [..., L]
    device: jax.Device
    width: int
    compile_seconds: float
    number: int = 0  # compilation number in this process
    memory: int = 0  # bytes that a call uses, as reported by the compiler; 0: not reported


def devices(count: int | None = None) -> list[PyTree]:
    """Return the device of each simultaneous call: one per core, or one per accelerator; `count` of them."""
    local = jax.devices()
    if local[0].platform == "cpu":
        return [local[0]] * (count or cores())
    return local[:count]


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def program(layout: Layout, job: Job, device: jax.Device | None = None) -> Program:
    """Compile the call for jobs shaped like `job` on a device (default: the first); once for each shape.

    Raises UserError if jax would compute in float32.
    """
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise UserError(
            "simulation: got float32 (jax_enable_x64 is off), expected float64: float32 rounds at 1e-7 of a signal, which is "
            "the size of errors compared here; call pcbench.setup(), or run inside jax.enable_x64(True)."
        )
    leaves, tree = jax.tree.flatten(arguments(job, layout.width))
    key = layout, device or jax.devices()[0], tree, tuple((np.shape(a), a.dtype) for a in leaves)
    return _PROGRAMS.ask(key, lambda: _compile_program(*key))


_PROGRAMS: program_cache.Programs[Program] = program_cache.Programs()
_NUMBERS = itertools.count(1)


def _compile_program(layout: Layout, device: jax.Device, tree: PyTree, shapes: tuple[PyTree, ...]) -> Program:
    sharding = jax.sharding.SingleDeviceSharding(device)
    args = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(s, d, sharding=sharding) for s, d in shapes])
    options, start = OPTIONS if device.platform == "cpu" else None, perf_counter()

    def simulate(p: GridPointParams, root_seed: Array, seeds: Array, schedules: PyTree) -> RunSums:
        if layout.by_definition:
            return simulate_runs(layout, p, root_seed, seeds, schedules)
        return event_loop.simulate(layout, p, root_seed, seeds)

    call = program_store.compile_program(simulate, layout, args, options, RESULT_TYPES)
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
    """Return the working memory of a call plus three times its arguments and results (this, the next and the previous call)."""
    try:
        m = call.memory_analysis()
        return int(m.temp_size_in_bytes + 3 * (m.argument_size_in_bytes + m.output_size_in_bytes))
    except (AttributeError, NotImplementedError, RuntimeError):
        return 0


def compilations() -> int:
    """Return how many programs this process has traced and compiled."""
    return _PROGRAMS.compilations


def arguments(job: Job, width: int) -> tuple[GridPointParams, PyTree, PyTree, PyTree]:
    """Return the arguments of a call: arrays, with a short list of seeds padded by repetition."""
    index = np.resize(np.arange(len(job.seeds)), width)
    schedules = jax.tree.map(lambda a: a[index], job.schedules)
    return jax.tree.map(np.asarray, job.problem), np.asarray(job.root_seed), job.seeds[index], schedules


def serial(compiled: Program, jobs: Iterable[Job]) -> Iterator[tuple[Job, RunSums]]:
    """Simulate jobs one after another; yield each with its sums, as NumPy arrays [..., L].

    The next call is submitted before the previous results are read.
    """
    pending: list[tuple[Job, PyTree]] = []
    for job in jobs:
        args = arguments(job, compiled.width)
        if job.schedules is not None:  # shapes differ if more packets arrive at one tick
            compiled = program(compiled.layout, job, compiled.device)
        pending.append((job, compiled.call(*args)))
        if len(pending) > 1:
            yield _to_numpy(*pending.pop(0))
    for job, out in pending:
        yield _to_numpy(job, out)


def run(layout: Layout, jobs: list[Job], count: int | None = None) -> Iterator[tuple[Job, RunSums]]:
    """Simulate jobs of one shape, `count` at a time (default: all cores or accelerators); yield them in order."""
    run_devices = devices(count)
    with thread_pools.pool(len(run_devices)) as threads:
        programs = [program(layout, jobs[0], device) for device in run_devices]
        futures = []
        for i, job in enumerate(jobs):
            compiled = programs[i % len(programs)]
            futures.append(threads.submit(in_float64, next, serial(compiled, [job])))
            if len(futures) > 2 * len(run_devices):
                yield futures.pop(0).result()
        for future in futures:
            yield future.result()


def in_float64(function: Any, *args: PyTree) -> PyTree:
    """Call a function with float64 on: jax has this setting per thread."""
    with config.float64():
        return function(*args)


def _to_numpy(job: Job, out: RunSums) -> tuple[Job, RunSums]:
    runs = (..., slice(len(job.seeds)))
    return job, jax.tree.map(operator.itemgetter(runs), jax.tree.map(np.asarray, out))
