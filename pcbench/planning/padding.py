"""One shape for many cells: room for the largest of them, so that they share a compiled program.

Room is what no number depends on: slots, rings, rows; and what some cells draw beside the noise, of which the others get a
neutral one (outliers of probability 0, a quantization step of 0, infinitely many degrees of freedom) unless the definition
simulates them. A cell's own numbers and everything else in its layout stay as drafted, so that alone it has the same bits as
among others.
"""

from collections.abc import Hashable, Iterable, Iterator
from functools import lru_cache, reduce
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from pcbench.errors import is_ours
from pcbench.planning import loop_setup, memo
from pcbench.plants.nonlinear import PlantFunction
from pcbench.protocols import Observer, Plant
from pcbench.simulation import shape_checks
from pcbench.simulation.measurements import Outliers, Rounding
from pcbench.simulation.schedule import common_times, random_times
from pcbench.simulation.types import GridPointParams, Layout
from pcbench.study.grid import Cell
from pcbench.synthesis.certificate import Certificate, power_of_2

# one for all runs, or numbers by which each run draws its own
AnySchedule = common_times.Schedule | random_times.ClockParams


class Plan(NamedTuple):
    """A cell ready to run."""

    cell: Cell
    layout: Layout
    problem: GridPointParams
    certificates: dict[str, Certificate]
    bound: NDArray[np.float64] | None  # [n] root-mean-square over the tail that no causal estimator beats, where known
    predicts_unknown_input: dict[str, bool | None]  # by observer, of its prediction to now
    labels: tuple[str, ...]  # of the layout's observers; they go by their base in a closed loop, to share a program
    reach: loop_setup.Reach | None  # of a closed loop


class Capacity(NamedTuple):
    """The room that the largest of some cells needs."""

    slots: int = 1  # arrivals at one tick
    due: int = 0  # samples of a run on a schedule of its own
    shares: int = 0  # delays among which those of samples are drawn, each by itself
    ring: int = 0  # packets on the network
    early: int = 0  # packets on it at the start
    notes: int = 0  # for which observers note what they need at one tick, besides the first
    back: int = 0  # ticks a closed loop looks back
    ahead: int = 0  # and ahead
    falls: int = 0  # jumps of the unknown input
    pending: int = 0  # commands on their way over a network
    outliers: bool = False  # some samples are outliers,
    rounding: bool = False  # are rounded,
    tail: bool = False  # have noise of Student's distribution
    rows: tuple[tuple[tuple[str, int], int], ...] = ()  # by plant and leaf of its numbers


def room_of(p: Plan) -> Capacity:
    """Return the room that one draft needs."""
    schedule, common = p.problem.schedule, isinstance(p.problem.schedule, common_times.Schedule)
    rows = {(p.cell.scenario.plant, i): len(a) for i, a in enumerate(jax.tree.leaves(p.problem.params)) if np.ndim(a)}
    back, ahead = p.reach or (0, 0)
    return Capacity(
        slots=schedule.arrive.shape[1] if common else 1,
        due=0 if common else schedule.due.shape[1],
        shares=0 if common else schedule.share.shape[1],
        ring=power_of_2(p.layout.ring),
        early=power_of_2(len(schedule.early)) if common else 0,
        notes=schedule.also.shape[1] if common else 0,
        back=power_of_2(back),
        ahead=power_of_2(ahead),
        falls=len(p.problem.jumps),
        pending=power_of_2(p.layout.pending),
        outliers=bool(p.problem.outliers),
        rounding=bool(p.problem.rounding),
        tail=not isinstance(p.problem.tail, tuple),
        rows=tuple(rows.items()),
    )


def larger(a: Capacity, b: Capacity) -> Capacity:
    """Return room for both."""
    rows = dict(a.rows)
    for key, many in b.rows:
        rows[key] = max(rows.get(key, 0), many)
    return Capacity._make([*map(max, a[:-1], b[:-1]), tuple(rows.items())])


def fit_to_capacity(p: Plan, room: Capacity, ask: memo.Once = memo.anew) -> Plan:
    """Give a draft the shape that `room` asks for."""
    drafted, rows = p.problem.schedule, dict(room.rows)
    _, schedule = ask(
        "fitted", (id(drafted), room), lambda: (drafted, _pad_schedule(drafted, room))
    )  # alive: the id is its own
    leaves, tree = jax.tree.flatten(p.problem.params)
    for i, a in enumerate(leaves):
        if np.ndim(a) and len(a) == 1 < (many := rows[p.cell.scenario.plant, i]):
            leaves[i] = np.broadcast_to(a, (many, *np.shape(a)[1:]))
    falling = p.problem.jumps
    if more := room.falls - len(falling):
        falling = np.pad(falling, (0, more), constant_values=common_times.NEVER)
    problem = p.problem._replace(schedule=schedule, params=jax.tree.unflatten(tree, leaves), jumps=falling)
    if not p.layout.defined:  # what other cells draw, where this one has none: what changes no sample
        no_outliers, no_step = Outliers(np.asarray(0.0), np.asarray(1.0)), np.zeros(len(problem.noise_std))
        problem = problem._replace(
            outliers=problem.outliers or (no_outliers if room.outliers else ()),
            rounding=problem.rounding or (Rounding(no_step, np.asarray(0.0)) if room.rounding else ()),
            tail=np.asarray(np.inf) if room.tail and isinstance(problem.tail, tuple) else problem.tail,
        )
    layout = p.layout._replace(ring=room.ring)
    if p.reach:
        law, line = loop_setup.close(p.cell, loop_setup.Reach(room.back, room.ahead), p.cell.times.ticks)
        problem = problem._replace(control=law, line=line)
        layout = layout._replace(commands=room.back, pending=room.pending if layout.pending else 0)
    return p._replace(problem=problem, layout=layout)


def stack_schedules(each: list[common_times.Schedule]) -> common_times.Schedule:
    """Return schedules of runs in one, every array with the runs first."""
    room = Capacity(
        slots=power_of_2(max(s.arrive.shape[1] for s in each)),
        early=power_of_2(max(len(s.early) for s in each)),
        notes=power_of_2(max(s.also.shape[1] for s in each)),
    )
    stacked: common_times.Schedule = jax.tree.map(lambda *a: np.stack(a), *(_pad_schedule(s, room) for s in each))
    return stacked


def _pad_schedule(schedule: AnySchedule, room: Capacity) -> AnySchedule:
    if isinstance(schedule, random_times.ClockParams):
        return random_times.pad_times(schedule, room.due, room.shares)
    with_room = common_times.pad_early(common_times.pad_slots(schedule, room.slots), room.early)
    return common_times.pad_notes(with_room, room.notes)


def fit(drafts: list[Plan]) -> list[Plan]:
    """Give drafts one shape, and check that their observers keep to the protocol."""
    room = required_capacity(drafts)
    return [fit_to_capacity(p, room) for p in check_drafts(drafts)]


def required_capacity(drafts: Iterable[Plan]) -> Capacity:
    """Return the room for the largest of some drafts."""
    return reduce(larger, map(room_of, drafts), Capacity())


def check_drafts(drafts: Iterable[Plan]) -> Iterator[Plan]:
    """Yield drafts as they come; raise UserError where an observer does not keep to the protocol, on some kind of plant.

    Asked only where an observer or a plant has code of a user's: the others keep to it by test.
    """
    seen: set[tuple[str, Plant, bool]] = set()
    for p in drafts:
        for label, observer in p.layout.observers:
            if (
                _has_user_code(observer, p.layout.plant)
                and (key := (label, p.layout.plant, p.layout.continuous)) not in seen
            ):
                seen.add(key)
                shape_checks.check(label, observer, p.problem, p.layout.continuous)
        yield p


@lru_cache
def _has_user_code(observer: Observer, plant: Plant) -> bool:
    """Whether an observer or a plant has functions of a user's, themselves or in what `make_plant` makes of them."""
    parts = [part for part in (*observer, *plant) if callable(part)]
    return any(isinstance(part, PlantFunction) or not is_ours(part) for part in parts)


def key_of(p: Plan) -> Hashable:
    """Return what decides the compiled program of a fitted cell."""
    leaves, tree = jax.tree.flatten(p.problem)
    return p.layout, tree, tuple(np.shape(a) for a in leaves)
