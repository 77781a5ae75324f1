"""Inputs of a program of exact moments: parameters and schedules of many grid points of one shape, and their initial state.

Arrays common to a batch are stored once. Small arrays that may differ are stored per grid point, [..., C]. Grid points whose
tables differ are in different batches. `initial_run` returns the joint state before tick 0 as a function of the random initial
state.
"""

import itertools
from collections.abc import Hashable
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree
from numpy.typing import NDArray

from pcbench.simulation.closed_loop import first_loop_state
from pcbench.simulation.schedule.common_times import NEVER, Schedule
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, Layout, Packet

SEED = 20170607  # seed of the noise in runs that test whether a grid point is affine; no result depends on it
SCALES = (-8.0,)  # factor on the noise in these runs
LARGEST_PER_CELL = 256  # numbers of an array that is stored per grid point
COMMON_FIELDS = ("windows", "jumps", "network")  # never stored per grid point
Numbers: TypeAlias = Array | NDArray[Any]  # inside a program, and outside


class Event(NamedTuple):
    """The events of C grid points at one tick; of E ticks, [E, ...]."""

    sense: Numbers  # [C] the packet taken; -1: none
    snapshot: Numbers  # [C]
    sampled_channels: Numbers  # [q, C] the channels that are sampled
    arrive: Numbers  # [S, C]
    timestamp: Numbers  # [S, C] assumed sampling tick
    mask: Numbers  # [S, q, C]
    number: Numbers  # [S, q, C]
    ticks_since_arrival: Numbers  # [S, C]
    extra_snapshots: Numbers  # [M, C] further packets with the same timestamp


class BatchSchedule(NamedTuple):
    """Schedules of C grid points by event: a tick with an event of any of them, and tick 0."""

    ticks: Numbers  # [E] ticks; after the last event, beyond N + 1
    events: Event
    early: Numbers  # [e, q, C] samples of packets taken before tick 0


class Mix(NamedTuple):
    """The modes that each of C modes may follow; s sources at most."""

    source: Numbers  # [s, C]
    weight: Numbers  # [s, C]; 0: padding
    merges: Numbers  # [N+1, C] whether modes merge at a tick


class MomentInputs(NamedTuple):
    """The parameters of C grid points."""

    problem: GridPointParams  # separate arrays of each grid point are [..., C]; its schedule is in `schedule`
    schedule: BatchSchedule
    arrivals: Numbers  # [N+1, P, S, q] noise of arrivals, in the runs that test whether a grid point is affine
    ticks: Numbers  # [N+1, P, w] process and command noise of these runs
    start: Numbers  # [P, 2 n] random initial state of these runs
    chance: Numbers  # [C] probability that a sample arrives
    network: tuple[Numbers, ...]  # (late, lost) [J, 1, C] uniform numbers of every network decision; (): no network
    mix: Mix | tuple[()] = ()  # if the grid points are modes


def batch_schedule(schedules: list[Schedule]) -> BatchSchedule:
    """Return schedules of one shape side by side."""
    ticks, has_event = len(schedules[0].event), schedules[0].event.copy()
    for s in schedules[1:]:
        has_event |= s.event
    has_event[0] = True
    event_ticks = np.flatnonzero(has_event)
    capacity = min(_capacity(len(event_ticks) + 1), ticks + 1)  # one after the last; few sizes, for few programs
    rows = np.pad(event_ticks, (0, capacity - len(event_ticks)))
    by_id = {id(s): _events(s, rows) for s in schedules}  # grid points of a study share them
    fields = zip(*(by_id[id(s)] for s in schedules), strict=True)
    events = Event(*(np.stack(field, -1) for field in fields))
    event_ticks = np.pad(event_ticks, (0, capacity - len(event_ticks)), constant_values=NEVER)
    return BatchSchedule(event_ticks, events, np.stack([s.early for s in schedules], -1))


def _capacity(count: int) -> int:
    """Return the least of 64, 256, 1024 ... that is large enough."""
    return next(size for size in (64 << 2 * i for i in itertools.count()) if size >= count)


def _events(s: Schedule, at: NDArray[np.intp]) -> Event:
    return Event(
        sense=s.sense[at],
        snapshot=s.snapshot[at],
        sampled_channels=s.sample[at] >= 0,
        arrive=s.arrive[at],
        timestamp=s.timestamp[at],
        mask=s.mask[at],
        number=s.number[at],
        ticks_since_arrival=s.ticks_since_arrival[at],
        extra_snapshots=s.extra_snapshots[at],
    )


def is_per_cell(problem: GridPointParams) -> tuple[bool, ...]:
    """Return for each array of a problem without its schedule whether it is stored per grid point: if small, and not common."""
    leaves, tree = jax.tree.flatten(problem._replace(schedule=()))
    return tuple(may and 0 < np.size(a) <= LARGEST_PER_CELL for may, a in zip(_may_differ(tree), leaves, strict=True))


@lru_cache(256)
def _may_differ(tree: jax.tree_util.PyTreeDef) -> list[bool]:
    """Return whether each array of a problem belongs to none of COMMON_FIELDS."""
    fields = jax.tree.unflatten(tree, range(tree.num_leaves))._asdict()
    return [name not in COMMON_FIELDS for name, field in fields.items() for _ in jax.tree.leaves(field)]


def batch_key(problem: GridPointParams, digests: dict[int, Hashable]) -> Hashable:
    """Return what must be equal for grid points to share a batch: every array that is not stored per grid point.

    `digests` caches digests of live arrays by id, as most arrays are common to all grid points.
    """
    leaves, tree = jax.tree.flatten(problem._replace(schedule=()))
    common = [a for a, per_cell in zip(leaves, is_per_cell(problem), strict=True) if not per_cell]
    for a in common:
        if id(a) not in digests:
            numbers = np.asarray(a)
            digests[id(a)] = numbers.shape, numbers.dtype.str, numbers.tobytes()
    return tree, tuple(digests[id(a)] for a in common)


def stack_inputs(
    problems: list[GridPointParams], network: list[tuple[NDArray[np.float64], ...]], chance: list[float]
) -> MomentInputs:
    """Return the parameters of grid points with the same long tables, side by side."""
    flat = [jax.tree.leaves(p._replace(schedule=())) for p in problems]
    per_cell, tree = is_per_cell(problems[0]), jax.tree.structure(problems[0]._replace(schedule=()))
    leaves = [
        np.stack(arrays, -1) if is_separate else np.asarray(arrays[0])
        for is_separate, arrays in zip(per_cell, zip(*flat, strict=True), strict=True)
    ]
    p, draw = problems[0], np.random.default_rng(SEED).normal
    n_noise = len(p.process_std) + (len(p.network.std) if p.network else 0)
    ticks, slots = p.schedule.arrive.shape
    size = np.asarray(SCALES)
    return MomentInputs(
        problem=jax.tree.unflatten(tree, leaves),
        schedule=batch_schedule([p.schedule for p in problems]),
        arrivals=draw(size=(ticks, len(size), slots, len(p.noise_std))) * size[:, None, None],
        ticks=draw(size=(ticks, len(size), n_noise)) * size[:, None],
        start=draw(size=(len(size), 2 * len(p.x0))) * size[:, None],
        chance=np.array(chance),
        network=tuple(np.stack(arrays, -1) for arrays in zip(*network, strict=True)),
    )


def initial_run(layout: Layout, p: GridPointParams, k: Array, state: PyTree, draws: Array, inputs: PyTree) -> Run:
    """Return the state before tick 0 of one grid point; draws [2 n], of mean 0 and variance 1, for plant and estimate."""
    n = p.x0.shape[0]
    x = p.x0 + p.spread0 @ draws[:n] if layout.random_initial_state else jnp.asarray(p.x0) * 1.0
    scatter = p.scatter * draws[n:] / jnp.sqrt(3.0) if layout.scattered else 0.0  # std of a uniform number in -1 .. 1
    xhat0 = p.xhat0 + scatter
    memories = {label: o.init(p.gains[label], xhat0) for label, o in layout.observers}
    loop = first_loop_state(layout, p, memories)
    return Run(
        x=x,
        memories=memories,
        flight=Packet((), {}),  # packets in flight are in `events.BatchState`
        streams={},
        watches={},
        commands=loop.commands,
        law=loop.law,
    )
