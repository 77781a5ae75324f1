"""From cells to their moments: cells that share a program and their long tables go through it together, some at a time.

Cells are planned while others are computed, so that what is held does not grow with their number.

Observers of a cell whose numbers overflow do not take the others with them.

In a joint covariance a zero stands between observers that share nothing, and zero times infinity is not a number. Where a call
leaves anything that is not finite, each observer is computed again by itself, and what it says of itself is what counts.
Covariances between two observers stay those of the joint call.
"""

from collections.abc import Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.engine import runner
from pcbench.moments import items as items_of
from pcbench.moments.delay_modes import delays_alone
from pcbench.moments.error_sums import Sums, nothing, strayed
from pcbench.moments.inputs import shared_of
from pcbench.moments.items import Asked, Item
from pcbench.moments.mode_mixing import combined
from pcbench.moments.nees import Believed
from pcbench.moments.noise_state import form_of
from pcbench.moments.plant_affinity import ROUNDING, bent
from pcbench.moments.programs import MANY, compute, width_of
from pcbench.moments.realisations import Realised, losses_alone, realised
from pcbench.moments.types import Found
from pcbench.planning import drafts, padding
from pcbench.planning.padding import Plan
from pcbench.runtime import thread_pools
from pcbench.simulation.schedule import random_times
from pcbench.study.grid import Cell
from pcbench.synthesis.certificate import power_of_2

ALONE = "observer"  # what an observer is called that goes by itself


def computed(ones: list[Realised], recorded: str, every: int = 1, width: int | None = None) -> Found:
    """Return what cells of one layout leave, [..., at least as many as there are], no observer spoilt by another."""
    found = compute(ones, recorded, every, width)
    layout = ones[0].layout
    spoilt = [
        at for at in range(len(ones)) if not all(np.isfinite(a[..., at]).all() for a in jax.tree.leaves(found.sums))
    ]
    if layout.controller or len(layout.observers) == 1 or not spoilt:
        return found
    found, first = jax.tree.map(np.array, found), 0
    for name in sorted(name for name, _ in layout.observers):
        own = compute([_of(ones[at], name) for at in spoilt], recorded, every)
        many = own.sums.mean.shape[0]
        for place, at in enumerate(spoilt):
            _put(found, at, slice(first, first + many), jax.tree.map(lambda a, i=place: a[..., i], own), name)
        first += many
    return found


def _of(one: Realised, name: str) -> Realised:
    """The same cell with one of its observers."""
    layout = one.layout._replace(observers=tuple((ALONE, o) for n, o in one.layout.observers if n == name))
    return one._replace(layout=layout, problem=one.problem._replace(gains={ALONE: one.problem.gains[name]}))


def _put(found: Found, at: int, mine: slice, own: Found, name: str) -> None:
    """Write what one observer left of cell `at` over what the joint call says of its signals `mine`."""
    for field in ("square", "absolute"):
        getattr(found.sums, field)[:, mine, at] = getattr(own.sums, field)
    for field in ("mean", "std", "reach", "apart", "size"):
        getattr(found.sums, field)[mine, at] = getattr(own.sums, field)
    if found.rows:
        found.rows.mean[:, mine, at] = own.rows.mean
        _block(found.rows.covariance, mine)[..., at] = own.rows.covariance
    if found.last:
        found.last.covariance[mine, mine, at] = own.last.covariance
        if name in found.last.believed:
            found.last.believed[name][..., at] = own.last.believed[ALONE]


def _block(covariance: Any, mine: slice) -> Any:
    """The part [N+1, z, z or 1, C] of recorded covariances that is between signals of one observer."""
    return covariance[:, mine] if covariance.shape[2] == 1 else covariance[:, mine, mine]


SPLIT = 64  # cells, of more than which each observer goes by itself
PACKETS = 8  # room of cells that have no more on the network: at an event all of it is gone through
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
    mixture: bool = False  # over losses or delays: means and squares are exact, and no distribution is normal
    why: dict[str, str] = {}  # by observer label, why it has no exact answer, empty: it has (`exactness`)  # noqa: RUF012
    reached: Any = ()  # [2, n, S] as in `Found`
    shares: Any = None  # [S] of `last`, whose realisations are modes of the cell; None: each counts alike


def planned(cells: list[Cell], together: bool = False) -> Iterator[Plan]:
    """Yield the cells ready to run, with one of two rooms for packets: few shapes, few programs; or with what a cell needs.

    That is where noise reaches what is on the network, and the covariance has all of the room.

    Of many cells each observer goes by itself, and of one whose observers remember much, as the work grows with the square of
    what noise reaches, and more; unless they are to be `together`.
    """
    split = len(cells) > SPLIT
    most = max(map(_ring, cells))
    least = PACKETS if len(cells) > WAITING else most  # of so many cells another program is worth its time
    for p in padding.checked(drafts(cells)):
        room = padding.room_of(p)
        own = _ring(p.cell)
        fitted = padding.fitted(p, room)  # a loop has its controller's numbers from here on
        places = power_of_2(own if _carried(fitted) else most if own > least else min(most, least))
        whole = fitted._replace(layout=fitted.layout._replace(ring=max(room.ring, places)))
        mixed = losses_alone(whole) or delays_alone(whole)
        apart = not together and (split or mixed or _remembered(whole) > LARGE)
        yield from _split(whole) if apart else [whole]


def _ring(cell: Cell) -> int:
    """How many packets of a cell may be on the network, whatever is drawn."""
    return random_times.room(cell.times.clocks, cell.times.ticks, cell.times.error)


def _carried(p: Plan) -> bool:
    """Whether noise reaches what is on the network, besides that of the samples themselves."""
    drifting = p.layout.drifting and p.layout.plant.of_run is None  # else a realisation has the numbers of its plant
    return form_of(p.layout._replace(drifting=drifting), p.problem).flight


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
    done, unlike = 0, set[Hashable]()
    with thread_pools.pool(runner.cores()) as threads:
        for items, found in _computed(threads, _batches(plans, asked, unlike), asked):
            for at, item in enumerate(items):
                parts.setdefault(item.cell, []).append(Part(item, jax.tree.map(lambda a, at=at: a[..., at], found)))
            while done in parts and len(parts[done]) == parts[done][0].item.many:
                mine = parts.pop(done)
                if (whole := mine[0].item.whole) and not _answered(mine):
                    if mine[0].item.one.mode:
                        unlike.add(items_of.kind(whole))
                    mine = runner.in_float64(_averaged, mine[0].item, asked)
                yield _gathered(mine)
                done += 1


class Part(NamedTuple):
    """What it left."""

    item: Item
    found: Found


def _answered(parts: list[Part]) -> bool:
    """Whether what was computed of a cell says all: modes met alike, or what was tried has no exact answer."""
    if parts[0].item.one.mode:
        return bool(np.max([part.found.unlike for part in parts]) <= ROUNDING)
    (found,) = (part.found for part in parts)
    alone: Sums = jax.tree.map(lambda a: a[..., None], found.sums)  # of the one realisation and the one observer
    return bool((strayed(alone, slice(None), np.asarray(found.reached)[..., None]) > ROUNDING).any())


def _averaged(item: Item, asked: Asked) -> list[Part]:
    """Compute a cell on drawn schedules: its observer remembers more than its modes tell, or is affine where it was doubted."""
    drawn = [realised(item.whole, asked.root_seed, seed) for seed in range(asked.schedules)] if item.whole else []
    out: list[Part] = []
    for first in range(0, len(drawn), MANY):
        ones = drawn[first : first + MANY]
        found = _kept(ones, asked)
        for at, one in enumerate(ones):
            mine = item._replace(place=first + at, many=len(drawn), random=True, one=one, whole=None)
            out.append(Part(mine, jax.tree.map(lambda a, at=at: a[..., at], found)))
    return out


def _batches(plans: Iterable[Plan], asked: Asked, unlike: set[Hashable]) -> Iterator[list[Item]]:
    """Yield the cells of each call; cells whose kind is `unlike` are not tried by modes."""
    groups: dict[Hashable, list[Item]] = {}
    for number, p in enumerate(plans):
        if (bend := bent(p)) > ROUNDING:  # nothing is compiled for it
            yield [items_of.bent(p, number, bend)]
            continue
        for item in items_of.cell(p, number, asked, unlike):
            key = item.one.layout, shared_of(item.one.problem), item.one.mode is not None
            together = item.many if item.whole and not item.place else 1  # modes of a cell share a call
            if len(groups.get(key, [])) + together > MANY:
                yield groups.pop(key)
            group = groups.setdefault(key, [])
            group.append(item)
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
    threads: ThreadPoolExecutor, batches: Iterable[list[Item]], asked: Asked
) -> Iterator[tuple[list[Item], Found]]:
    """Yield batches in their order with what they left, some under way at a time."""
    waiting: list[tuple[list[Item], Future[Found]]] = []
    wide = set[Hashable]()  # of this call alone: what was computed before decides no bit
    for items in batches:
        work: tuple[Any, ...] = (_refused, items[0])
        if not items[0].bend:
            ones = [item.one for item in items]
            work = _kept, ones, asked, width_of(ones, wide)
        waiting.append((items, threads.submit(runner.in_float64, *work)))
        if len(waiting) > 2 * runner.cores():
            first, future = waiting.pop(0)
            yield first, future.result()
    for items, future in waiting:
        yield items, future.result()


def _kept(ones: list[Realised], asked: Asked, width: int | None = None) -> Found:
    """Compute a batch, and of what is recorded keep what is asked for: cells are read one by one, and first."""
    found = computed(ones, asked.recorded, asked.every(int(ones[0].problem.windows[-1, 1])), width)
    return found._replace(rows=jax.tree.map(_cells_first, found.rows))


def _cells_first(a: Any) -> Any:
    """The same array [..., C], with each cell's numbers together in memory."""
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(a, -1, 0)), 0, -1)


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
    modes = [part.item.one.mode for part in parts if part.item.one.mode]
    shares = np.array([mode.share for mode in modes]) if modes else None
    called = dict(zip((name for name, _ in p.layout.observers), p.labels, strict=True))
    at, places = 0, {}
    for name, many in sorted(parts[0].item.sizes.items()):
        places[called[name]] = slice(at, at + many)
        at += many
    total = whole if shares is None else combined(whole, shares)
    return CellMoments(
        planned=p,
        random=parts[0].item.random,
        signals=places,
        sums=total.sums,
        rows=total.rows,
        last=_believed(p, places, called, whole),
        mixture=parts[0].item.one.chance < 1 or shares is not None,
        reached=whole.reached,
        shares=shares,
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
