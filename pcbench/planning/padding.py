"""Padding to a common shape: room for the largest of many grid points, so that they share a compiled program.

Padding does not change any number. It adds slots, ring entries and rows. Random effects that only some grid points have get
neutral values in the others: outliers of probability 0, a quantization step of 0, infinitely many degrees of freedom. The
reference definition has no such padding. All else in a layout stays as drafted. So a grid point has the same bits alone as
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

# one schedule for all runs, or parameters from which each run draws its own
AnySchedule = common_times.Schedule | random_times.ClockParams


class Plan(NamedTuple):
    """A grid point ready to run."""

    cell: Cell
    layout: Layout
    problem: GridPointParams
    certificates: dict[str, Certificate]
    bound: NDArray[np.float64] | None  # [n] smallest RMSE over the tail of any causal estimator; None: not available
    predicts_unknown_input: dict[str, bool | None]  # by observer, for its prediction to the present
    # of the layout's observers; in a closed loop the layout has their base names, to share a program
    labels: tuple[str, ...]
    reach: loop_setup.Reach | None  # closed loop only


class Capacity(NamedTuple):
    """The room that the largest of some grid points needs."""

    slots: int = 1  # arrivals at one tick
    due: int = 0  # samples per clock and run, if each run has its own schedule
    shares: int = 0  # values of an independently drawn delay
    ring: int = 0  # packets on the network at one time
    early: int = 0  # packets from before tick 0
    extra_snapshots: int = 0  # snapshots at one tick, in addition to the first
    back: int = 0  # ticks of stored commands in a closed loop
    lookahead: int = 0  # ticks past the end in a closed loop
    jumps: int = 0  # jumps of the unknown input
    pending: int = 0  # commands on a network at one time
    outliers: bool = False  # there are outliers
    rounding: bool = False  # samples are quantized
    tail: bool = False  # noise is Student's t
    rows: tuple[tuple[tuple[str, int], int], ...] = ()  # by plant and leaf of its parameters


def capacity_of(p: Plan) -> Capacity:
    """Return the room that one draft needs."""
    schedule, common = p.problem.schedule, isinstance(p.problem.schedule, common_times.Schedule)
    rows = {(p.cell.scenario.plant, i): len(a) for i, a in enumerate(jax.tree.leaves(p.problem.params)) if np.ndim(a)}
    back, lookahead = p.reach or (0, 0)
    return Capacity(
        slots=schedule.arrive.shape[1] if common else 1,
        due=0 if common else schedule.due.shape[1],
        shares=0 if common else schedule.delay_cdf.shape[1],
        ring=power_of_2(p.layout.ring),
        early=power_of_2(len(schedule.early)) if common else 0,
        extra_snapshots=schedule.extra_snapshots.shape[1] if common else 0,
        back=power_of_2(back),
        lookahead=power_of_2(lookahead),
        jumps=len(p.problem.jumps),
        pending=power_of_2(p.layout.pending),
        outliers=bool(p.problem.outliers),
        rounding=bool(p.problem.rounding),
        tail=not isinstance(p.problem.student_t_dof, tuple),
        rows=tuple(rows.items()),
    )


def larger(a: Capacity, b: Capacity) -> Capacity:
    """Return room that is enough for both."""
    rows = dict(a.rows)
    for key, n in b.rows:
        rows[key] = max(rows.get(key, 0), n)
    return Capacity._make([*map(max, a[:-1], b[:-1]), tuple(rows.items())])


def fit_to_capacity(p: Plan, room: Capacity, cache: memo.Cache = memo.no_cache) -> Plan:
    """Return a draft padded to the shape of `room`."""
    draft_schedule, rows = p.problem.schedule, dict(room.rows)
    key = id(draft_schedule), room  # the cache keeps the object alive, so its id is unique
    _, schedule = cache("schedules", key, lambda: (draft_schedule, _pad_schedule(draft_schedule, room)))
    leaves, tree = jax.tree.flatten(p.problem.params)
    for i, a in enumerate(leaves):
        if np.ndim(a) and len(a) == 1 < (n_rows := rows[p.cell.scenario.plant, i]):
            leaves[i] = np.broadcast_to(a, (n_rows, *np.shape(a)[1:]))
    jump_ticks = p.problem.jumps
    if n_missing := room.jumps - len(jump_ticks):
        jump_ticks = np.pad(jump_ticks, (0, n_missing), constant_values=common_times.NEVER)
    problem = p.problem._replace(schedule=schedule, params=jax.tree.unflatten(tree, leaves), jumps=jump_ticks)
    if not p.layout.by_definition:  # neutral values for the random effects of other grid points
        no_outliers, no_step = Outliers(np.asarray(0.0), np.asarray(1.0)), np.zeros(len(problem.noise_std))
        dof = problem.student_t_dof
        problem = problem._replace(
            outliers=problem.outliers or (no_outliers if room.outliers else ()),
            rounding=problem.rounding or (Rounding(no_step, np.asarray(0.0)) if room.rounding else ()),
            student_t_dof=np.asarray(np.inf) if room.tail and isinstance(dof, tuple) else dof,
        )
    layout = p.layout._replace(ring=room.ring)
    if p.reach:
        control, line = loop_setup.close(p.cell, loop_setup.Reach(room.back, room.lookahead), p.cell.times.ticks)
        problem = problem._replace(control=control, line=line)
        layout = layout._replace(commands=room.back, pending=room.pending if layout.pending else 0)
    return p._replace(problem=problem, layout=layout)


def stack_schedules(schedules: list[common_times.Schedule]) -> common_times.Schedule:
    """Return the schedules of several runs stacked, every array with the runs first."""
    room = Capacity(
        slots=power_of_2(max(s.arrive.shape[1] for s in schedules)),
        early=power_of_2(max(len(s.early) for s in schedules)),
        extra_snapshots=power_of_2(max(s.extra_snapshots.shape[1] for s in schedules)),
    )
    stack: common_times.Schedule = jax.tree.map(lambda *a: np.stack(a), *(_pad_schedule(s, room) for s in schedules))
    return stack


def _pad_schedule(schedule: AnySchedule, room: Capacity) -> AnySchedule:
    if isinstance(schedule, random_times.ClockParams):
        return random_times.pad_clock_params(schedule, room.due, room.shares)
    padded = common_times.pad_early(common_times.pad_slots(schedule, room.slots), room.early)
    return common_times.pad_snapshots(padded, room.extra_snapshots)


def fit(drafts: list[Plan]) -> list[Plan]:
    """Return drafts padded to one shape, after a check of their observers against the protocol."""
    room = required_capacity(drafts)
    return [fit_to_capacity(p, room) for p in check_drafts(drafts)]


def required_capacity(drafts: Iterable[Plan]) -> Capacity:
    """Return the room for the largest of some drafts."""
    return reduce(larger, map(capacity_of, drafts), Capacity())


def check_drafts(drafts: Iterable[Plan]) -> Iterator[Plan]:
    """Yield drafts as they come; raise UserError if an observer violates the protocol on some kind of plant.

    Only user-defined observers and plants are checked. Those of pcbench are covered by tests.
    """
    keys: set[tuple[str, Plant, bool]] = set()
    for p in drafts:
        for label, observer in p.layout.observers:
            key = label, p.layout.plant, p.layout.continuous
            if key not in keys and _has_user_code(observer, p.layout.plant):
                keys.add(key)
                shape_checks.check(label, observer, p.problem, p.layout.continuous)
        yield p


@lru_cache
def _has_user_code(observer: Observer, plant: Plant) -> bool:
    """Return whether an observer or a plant has user-defined functions, directly or in the result of `make_plant`."""
    parts = [part for part in (*observer, *plant) if callable(part)]
    return any(isinstance(part, PlantFunction) or not is_ours(part) for part in parts)


def key_of(p: Plan) -> Hashable:
    """Return the key of a fitted grid point's compiled program."""
    leaves, tree = jax.tree.flatten(p.problem)
    return p.layout, tree, tuple(np.shape(a) for a in leaves)
