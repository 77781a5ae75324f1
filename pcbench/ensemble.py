"""Many runs at once: blocks of lanes over all devices, always in calls of one compiled width.

A *job* is one cell's `Problem` with up to `width` seeds; short blocks are padded, so a run has the same bits alone, in any
block, and on any number of devices but for rounding (a program for two devices may be fused in another way: seen with ekf,
1e-15 of a signal). Jobs are stacked, one per device, and each device works on its own.
"""

import operator
from collections.abc import Iterable, Iterator
from functools import lru_cache
from time import perf_counter
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pcbench import simulation
from pcbench.errors import UserError
from pcbench.problem import Layout, Outcome, Problem

WIDTH = 1024  # lanes a call and device
HEAVY = 256  # of a plant whose ticks cost much: on the arm 1024 lanes are no faster a lane, and few seeds fill them


class Job(NamedTuple):
    """The runs of one cell that one device simulates in one call."""

    problem: Problem
    root_seed: int
    seeds: np.ndarray  # at most `width`


class Program(NamedTuple):
    """A compiled call and what it took to make."""

    call: Any  # (problems, root seeds [D], seeds [D, L]) -> Outcome with arrays [D, ..., L]
    devices: int
    width: int
    compile_seconds: float
    compiled: Any  # the executable itself, for those who want to read it


def program(layout: Layout, job: Job, devices: int | None = None) -> Program:
    """Compile the call for jobs shaped like `job` on so many devices (default all); once for each shape.

    Raises UserError where jax would compute in float32.
    """
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise UserError(
            "simulation: got float32 (jax_enable_x64 is off), expected float64: float32 rounds at 1e-7 of a signal, which is "
            "the size of errors compared here; call pcbench.setup(), or run inside jax.enable_x64(True)."
        )
    count = devices or len(jax.devices())
    arguments = stack([job] * count, layout.width)
    leaves, tree = jax.tree.flatten(arguments)
    return _compiled(layout, count, tree, tuple((a.shape, a.dtype) for a in leaves))


@lru_cache(maxsize=64)
def _compiled(layout: Layout, devices: int, tree: Any, shapes: tuple[Any, ...]) -> Program:
    mesh = Mesh(np.array(jax.devices()[:devices]), ("device",))
    each = PartitionSpec("device")

    def one(problems: Problem, root_seed: Any, seeds: Any) -> Outcome:
        problem, *address = jax.tree.map(lambda a: a[0], (problems, root_seed, seeds))
        return jax.tree.map(lambda a: a[None], simulation.simulate(layout, problem, *address))

    mapped = jax.shard_map(one, mesh=mesh, in_specs=each, out_specs=each, check_vma=False)
    place = NamedSharding(mesh, each)
    arguments = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(s, d, sharding=place) for s, d in shapes])
    start = perf_counter()
    call = jax.jit(mapped, in_shardings=place, out_shardings=place).lower(*arguments).compile()
    return Program(lambda *a: call(*jax.device_put(a, place)), devices, layout.width, perf_counter() - start, call)


def compilations() -> int:
    """Return how many programs this process has traced and compiled."""
    return _compiled.cache_info().misses


def stack(jobs: list[Job], width: int) -> tuple[Problem, Any, Any]:
    """Stack one job per device; short seed lists are padded by repeating the first."""
    problems = jax.tree.map(lambda *a: np.stack([np.asarray(x) for x in a]), *(job.problem for job in jobs))
    seeds = np.stack([np.resize(job.seeds, width) for job in jobs])
    return problems, np.array([job.root_seed for job in jobs]), seeds


def run(made: Program, jobs: Iterable[Job]) -> Iterator[tuple[Job, Outcome]]:
    """Simulate jobs in order, one a device at a time; yield each with what it left, as NumPy arrays [..., L].

    The next call is handed to the devices before the last one's results are read.
    """
    waiting: list[tuple[list[Job], Any]] = []
    for group in _groups(jobs, made.devices):
        padded = group + [group[0]] * (made.devices - len(group))
        waiting.append((group, made.call(*stack(padded, made.width))))
        if len(waiting) > 1:
            yield from _read(*waiting.pop(0))
    for group, out in waiting:
        yield from _read(group, out)


def _groups(jobs: Iterable[Job], size: int) -> Iterator[list[Job]]:
    group: list[Job] = []
    for job in jobs:
        group.append(job)
        if len(group) == size:
            yield group
            group = []
    if group:
        yield group


def _read(group: list[Job], out: Outcome) -> Iterator[tuple[Job, Outcome]]:
    whole = jax.tree.map(np.asarray, out)
    for i, job in enumerate(group):
        mine = (i, ..., slice(len(job.seeds)))
        yield job, jax.tree.map(operator.itemgetter(mine), whole)
