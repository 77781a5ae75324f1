"""From cells to their moments: cells that share a program and their long tables go through it together, some at a time.

Cells are planned while others are computed, so that what is held does not grow with their number.
"""

from collections.abc import Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.moments.apart import ALONE, computed
from pcbench.moments.believed import Believed
from pcbench.moments.bending import ROUNDING, bent
from pcbench.moments.compiled import MANY
from pcbench.moments.given import shared_of
from pcbench.moments.program import Found
from pcbench.moments.realised import Realised, losses_alone, over_losses, random, realised
from pcbench.moments.sums import Sums, nothing
from pcbench.planning import drafts, padding
from pcbench.planning.padding import Plan
from pcbench.simulation import batch
from pcbench.simulation.problem import Problem
from pcbench.simulation.schedule import per_lane
from pcbench.study.cells import Cell

LARGE = 100  # numbers that the observers of a cell remember
WAITING = 8 * MANY  # realisations that wait for others to share a call with, and cells behind one that waits, at most


class CellMoments(NamedTuple):
    """Of one planned cell; S realisations of what is random besides the noise (1: nothing is)."""

    planned: Plan  # without its long tables
    random: bool  # other runs have other schedules
    signals: dict[str, slice]  # by observer label, its place among the Z signals
    sums: Sums  # arrays [..., S]
    rows: Any = ()  # Recorded [..., S]
    last: dict[str, Believed] = {}  # by observer label, of a study that asks for consistency  # noqa: RUF012
    mixture: bool = False  # over which samples are lost: means and squares are exact, and no distribution is normal


class Asked(NamedTuple):
    """What is asked of all cells of a study."""

    root_seed: int
    schedules: int  # realisations of a random cell: those of the first seeds
    recorded: str = ""  # nothing, "std" or "covariance" at every tick


def planned(cells: list[Cell], together: bool = False) -> Iterator[Plan]:
    """Yield the cells ready to run, with one room for packets: few shapes, few programs.

    Of many cells each observer goes by itself, and of one whose observers remember much, as the work grows with the square of
    what noise reaches, and more; unless they are to be `together`.
    """
    split = len(cells) > MANY
    ring = max(per_lane.room(c.times.clocks, c.times.ticks, c.times.error) for c in cells)
    for p in padding.checked(drafts(cells)):
        room = padding.room_of(p)
        whole = padding.fitted(p, room._replace(ring=max(room.ring, padding.rounded(ring))))
        apart = not together and (split or losses_alone(whole) or _remembered(whole) > LARGE)
        yield from _split(whole) if apart else [whole]


def _remembered(p: Plan) -> int:
    """How many numbers all observers of a planned cell remember."""
    memories = (jax.eval_shape(o.init, p.problem.gains[label], p.problem.xhat0) for label, o in p.layout.observers)
    return sum(a.size for memory in memories for a in jax.tree.leaves(memory))


def _split(p: Plan) -> Iterator[Plan]:
    """Yield a planned cell for each of its observers, of one name: what differs in gains alone shares a program, and calls."""
    for label, (name, one) in zip(p.labels, p.layout.observers, strict=True):
        layout, gains = p.layout._replace(observers=((ALONE, one),)), {ALONE: p.problem.gains[name]}
        yield p._replace(layout=layout, problem=p.problem._replace(gains=gains), labels=(label,))


def solve(plans: Iterable[Plan], asked: Asked) -> Iterator[CellMoments]:
    """Yield the moments of each planned cell, in their order."""
    parts: dict[int, list[Part]] = {}
    done = 0
    with ThreadPoolExecutor(batch.cores()) as pool:
        for items, found in _computed(pool, _batches(plans, asked), asked.recorded):
            for at, item in enumerate(items):
                parts.setdefault(item.cell, []).append(Part(item, jax.tree.map(lambda a, at=at: a[..., at], found)))
            while done in parts and len(parts[done]) == parts[done][0].item.many:
                yield _gathered(parts.pop(done))
                done += 1


class Item(NamedTuple):
    """One realisation of one cell."""

    planned: Plan  # without its long tables
    cell: int
    place: int  # which realisation, of
    many: int
    random: bool
    sizes: dict[str, int]  # by observer, what it estimates
    one: Realised
    bend: float = 0.0  # how far its plant is from affine, where it is and has noise


def _signals(p: Plan) -> dict[str, int]:
    """How many signals each observer of a planned cell estimates."""
    n = len(p.problem.x0)
    if n == len(p.problem.band):
        return {label: n for label, _ in p.layout.observers}

    def estimates(problem: Problem) -> dict[str, Any]:
        gains, xhat0 = problem.gains, problem.xhat0
        return {label: o.estimate(gains[label], o.init(gains[label], xhat0)) for label, o in p.layout.observers}

    return {label: e.shape[0] for label, e in jax.eval_shape(estimates, p.problem).items()}


class Part(NamedTuple):
    """What it left."""

    item: Item
    found: Found


def _batches(plans: Iterable[Plan], asked: Asked) -> Iterator[list[Item]]:
    """Yield the cells of each call."""
    groups: dict[Hashable, list[Item]] = {}
    for number, p in enumerate(plans):
        if (bend := bent(p)) > ROUNDING:  # nothing is compiled for it
            light = p._replace(problem=p.problem._replace(schedule=(), inputs=(), params=(), gains={}))
            one = Realised(p.layout, p.problem, ())
            yield [Item(light, number, place=0, many=1, random=False, sizes=_signals(p), one=one, bend=bend)]
            continue
        mixed = over_losses(p) if losses_alone(p) and len(p.layout.observers) == 1 else None
        drawn = random(p) and mixed is None
        many = asked.schedules if drawn else 1
        light = p._replace(problem=p.problem._replace(schedule=(), inputs=(), params=(), gains={}))
        for seed in range(many):
            one = mixed or realised(p, asked.root_seed, seed)
            key = one.layout, shared_of(one.problem)
            group = groups.setdefault(key, [])
            group.append(Item(light, number, place=seed, many=many, random=drawn, sizes=_signals(p), one=one))
            if len(group) == MANY:
                yield groups.pop(key)
        while groups and (due := _due(groups, number)):
            yield groups.pop(due)
    yield from groups.values()


def _due(groups: dict[Hashable, list[Item]], number: int) -> Hashable | None:
    """Which group is not to wait for more cells when so many were planned; None: all may.

    That is one that holds back the answers of many cells behind it, and where too many wait, the fullest: a call takes as long
    for few cells as for many.
    """
    oldest = next(iter(groups))
    if number - groups[oldest][0].cell > WAITING:
        return oldest
    many = sum(map(len, groups.values()))
    return max(groups, key=lambda key: len(groups[key])) if many > WAITING else None


def _computed(
    pool: ThreadPoolExecutor, batches: Iterable[list[Item]], recorded: str
) -> Iterator[tuple[list[Item], Found]]:
    """Yield batches in their order with what they left, some under way at a time."""
    waiting: list[tuple[list[Item], Future[Found]]] = []
    for items in batches:
        work = (_refused, items[0]) if items[0].bend else (computed, [item.one for item in items], recorded)
        waiting.append((items, pool.submit(batch.in_float64, *work)))
        if len(waiting) > 2 * batch.cores():
            first, future = waiting.pop(0)
            yield first, future.result()
    for items, future in waiting:
        yield items, future.result()


def _refused(item: Item) -> Found:
    return Found(refused(sum(item.sizes.values()), item.bend), ())


def refused(signals: int, bend: float) -> Sums:
    """Return what is left of a cell that was not computed: how far it is from affine."""
    nan: Sums = jax.tree.map(lambda a: np.full(a.shape, np.nan), nothing(signals, None, 1))
    one: Any = np.ones((signals, 1))
    return nan._replace(apart=bend * one, size=one)


def _gathered(parts: list[Part]) -> CellMoments:
    """Put the realisations of one cell together."""
    parts = sorted(parts, key=lambda part: part.item.place)
    p = parts[0].item.planned
    whole = jax.tree.map(
        lambda *a: a[0][..., None] if len(a) == 1 else np.stack(a, -1), *(part.found for part in parts)
    )
    called = dict(zip((name for name, _ in p.layout.observers), p.labels, strict=True))
    at, places = 0, {}
    for name, many in sorted(parts[0].item.sizes.items()):
        places[called[name]] = slice(at, at + many)
        at += many
    return CellMoments(
        planned=p,
        random=parts[0].item.random,
        signals=places,
        sums=whole.sums,
        rows=whole.rows,
        last=_believed(p, places, called, whole),
        mixture=parts[0].item.one.chance < 1,
    )


def _believed(p: Plan, places: dict[str, slice], called: dict[str, str], found: Found) -> dict[str, Believed]:
    """What is true of each observer's errors at the last tick beside what it believes, of those that say so."""
    if not found.last:
        return {}
    n, prior, out = len(p.problem.x0), np.diagonal(p.problem.spread0), {}
    for name, P in found.last.believed.items():
        mine = slice(places[called[name]].start, places[called[name]].start + n)
        true = np.asarray(found.sums.mean[mine]), np.asarray(found.last.covariance[mine, mine])
        out[called[name]] = Believed(*true, np.asarray(P[:n, :n]), prior)
    return out
