"""Compiled programs of exact moments and calls of them: `FEW` or `MANY` cells side by side, with directions enough."""

from functools import lru_cache
from threading import Lock
from typing import Any

import jax
import numpy as np

from pcbench.moments import program
from pcbench.moments.events import Size
from pcbench.moments.given import Given, own_of, together
from pcbench.moments.program import Found, Shape
from pcbench.moments.realised import Realised
from pcbench.simulation import batch
from pcbench.simulation.problem import Layout
from pcbench.simulation.schedule import shared

FEW, MANY = 8, 64  # cells a call: with 64 the state of a tick still fits a core's cache
PROBES = 2
LOST = 1e-10  # of a number's size: less has no effect on a variance in double precision


def compute(ones: list[Realised], recorded: str) -> Found:
    """Return what a batch leaves, [..., FEW or MANY]; with more directions where there were too few."""
    width = FEW if len(ones) <= FEW else MANY
    each = _alike([ones[i % len(ones)] for i in range(width)])
    layout, own = each[0].layout, own_of(each[0].problem)
    given = together([one.problem for one in each], [one.network for one in each])
    directions = _directions(each)
    while True:
        made = _program(layout, Shape(Size(width, directions, PROBES), own, recorded), given)
        found = jax.tree.map(np.asarray, made(given))
        if not (found.lost > LOST).any():
            return found
        directions *= 2


def _alike(each: list[Realised]) -> list[Realised]:
    """Give the schedules of some cells one shape."""
    slots = max(one.problem.schedule.arrive.shape[1] for one in each)
    early = max(len(one.problem.schedule.early) for one in each)
    wide = [shared.pad_early(shared.pad_slots(one.problem.schedule, slots), early) for one in each]
    return [one._replace(problem=one.problem._replace(schedule=s)) for one, s in zip(each, wide, strict=True)]


def _directions(each: list[Realised]) -> int:
    """How many directions to begin with: enough for observers that keep two numbers a signal, and packets on their way."""
    layout, p = each[0].layout, each[0].problem
    n, q, ticks = len(p.x0), len(p.noise_std), len(p.schedule.event)
    sampled = max(int((one.problem.schedule.sense >= 0).sum()) for one in each)
    every = ticks // max(sampled, 1)
    rank = (
        n + 2 * len(p.band) * len(layout.observers) + q * (min(layout.ring, sampled) + layout.commands // max(every, 1))
    )
    tick = n * (len(p.process_std) > 0) + (len(p.network.std) if layout.pending else 0)
    total = 2 * n + q * (sampled + len(p.schedule.early)) + ticks * tick
    return min(rank, total) + q + 8 * tick


_COMPILING = Lock()


def _program(layout: Layout, shape: Shape, given: Given) -> Any:
    leaves, tree = jax.tree.flatten(given)
    with _COMPILING:  # the second thread to ask waits for the first one's program
        return _compiled(layout, shape, tree, tuple((np.shape(a), np.asarray(a).dtype) for a in leaves))


@lru_cache(maxsize=32)
def _compiled(layout: Layout, shape: Shape, tree: Any, shapes: tuple[Any, ...]) -> Any:
    given = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(s, d) for s, d in shapes])
    lowered = jax.jit(program.run, static_argnums=(0, 1)).lower(layout, shape, given)
    return lowered.compile(batch.ONE_THREAD if jax.devices()[0].platform == "cpu" else None)


def compilations() -> int:
    """Return how many programs this process has compiled."""
    return _compiled.cache_info().misses
