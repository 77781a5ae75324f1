"""What a program of exact moments takes: many cells of one shape, their numbers and their schedules side by side.

What is the same in all cells of a batch stays one array; small arrays of numbers that may differ are one a cell, [..., C].
Cells whose long tables differ are not put in one batch.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from pcbench.simulation.problem import Problem
from pcbench.simulation.schedule.shared import Schedule

KEY = 20170607  # of the noise in runs that test whether a cell is affine: no result depends on it
SCALES = (-8.0,)  # of the noise in the runs that test whether a cell is affine
SMALL = 256  # numbers of an array that each cell may have its own of


class Plan(NamedTuple):
    """Schedules of C cells, by tick; q channels, S arrivals a tick, N + 1 ticks."""

    sense: Any  # [N+1, C] the packet taken; -1: none
    note: Any  # [N+1, C]
    sampled: Any  # [N+1, q, C] which channels are
    arrive: Any  # [N+1, S, C]
    believed: Any  # [N+1, S, C]
    fresh: Any  # [N+1, S, q, C]
    index: Any  # [N+1, S, q, C]
    since: Any  # [N+1, S, C]
    next_event: Any  # [N+1, C]
    early: Any  # [E, q, C] samples of packets taken before tick 0
    also: Any  # [N+1, M, C] more packets that are noted


class Given(NamedTuple):
    """The numbers of C cells."""

    problem: Problem  # own arrays of each cell are [..., C]; its schedule stands in `plan`
    plan: Plan
    arrivals: Any  # [N+1, P, S, q] noise of the runs that test whether a cell is affine: of what arrives
    ticks: Any  # [N+1, P, w] of the process and of commands
    start: Any  # [P, 2 n] of the start
    chance: Any  # [C] that a sample arrives at all
    network: Any  # (late, lost) [J, 1, C] uniform numbers of every decision of a network to the plant; (): none
    mix: Any = ()  # merging.Mix, where the cells are modes


def plan_of(schedules: list[Schedule]) -> Plan:
    """Lay out schedules of one shape side by side."""
    each = [_plan(s) for s in schedules]
    return Plan(*(np.stack(field, -1) for field in zip(*each, strict=True)))


def _plan(s: Schedule) -> Plan:
    return Plan(
        sense=s.sense,
        note=s.note,
        sampled=s.sample >= 0,
        arrive=s.arrive,
        believed=s.believed,
        fresh=s.fresh,
        index=s.number,
        since=s.since,
        next_event=s.next_event,
        early=s.early,
        also=s.also,
    )


def own_of(problem: Problem) -> tuple[bool, ...]:
    """Return for each array of a problem without its schedule whether each cell may have its own: if small, but for times."""
    times = problem._replace(schedule=(), windows=np.zeros(0), jumps=np.zeros(0), network=())
    own = jax.tree.map(lambda a: 0 < np.size(a) <= SMALL, times)
    return tuple(jax.tree.leaves(own._replace(network=jax.tree.map(lambda a: False, problem.network))))


def shared_of(problem: Problem) -> tuple[Any, ...]:
    """Return what must be equal in two cells that share a batch: every array that is not each cell's own."""
    leaves, tree = jax.tree.flatten(problem._replace(schedule=()))
    common = [np.asarray(a) for a, own in zip(leaves, own_of(problem), strict=True) if not own]
    return str(tree), tuple((a.shape, a.dtype.str, a.tobytes()) for a in common)


def together(problems: list[Problem], network: list[tuple[NDArray[np.float64], ...]], chance: list[float]) -> Given:
    """Lay out the numbers of cells that share their long tables side by side."""
    flat = [jax.tree.leaves(p._replace(schedule=())) for p in problems]
    own, tree = own_of(problems[0]), jax.tree.structure(problems[0]._replace(schedule=()))
    leaves = [
        np.stack(each, -1) if mine else np.asarray(each[0])
        for mine, each in zip(own, zip(*flat, strict=True), strict=True)
    ]
    p, draw = problems[0], np.random.default_rng(KEY).normal
    every = len(p.process_std) + (len(p.network.std) if p.network else 0)
    ticks, slots = p.schedule.arrive.shape
    size = np.asarray(SCALES)
    return Given(
        problem=jax.tree.unflatten(tree, leaves),
        plan=plan_of([p.schedule for p in problems]),
        arrivals=draw(size=(ticks, len(size), slots, len(p.noise_std))) * size[:, None, None],
        ticks=draw(size=(ticks, len(size), every)) * size[:, None],
        start=draw(size=(len(size), 2 * len(p.x0))) * size[:, None],
        chance=np.array(chance),
        network=tuple(np.stack(each, -1) for each in zip(*network, strict=True)),
    )
