"""From grid points to their moments: those with the same program and long tables are computed together in batches.

Grid points are planned while others are computed, one window at a time, so memory does not grow with their number. Each
observer is computed separately, so that an overflow stays within one observer: a joint covariance has zeros between observers,
and zero times infinity is NaN.
"""

from collections.abc import Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
from jax import Array
from numpy.typing import NDArray

from pcbench.engine import runner
from pcbench.moments.affinity import ROUNDING, is_curved, plant_curvature, refusal_beforehand
from pcbench.moments.delay_modes import realisations_over_modes
from pcbench.moments.error_sums import Sums, relative_deviation, zero_sums
from pcbench.moments.inputs import Numbers, batch_key
from pcbench.moments.nees import FinalErrors
from pcbench.moments.noise_state import form_of
from pcbench.moments.programs import MANY, compute, width_of
from pcbench.moments.propagate import MomentRecord, Outcome
from pcbench.moments.realisations import (
    Realisation,
    draw_realisation,
    is_random,
    only_losses_random,
    realisation_over_losses,
)
from pcbench.planning import drafts, padding
from pcbench.planning.padding import Plan
from pcbench.runtime import thread_pools
from pcbench.simulation.schedule import random_times
from pcbench.simulation.types import GridPointParams
from pcbench.study.grid import Cell
from pcbench.synthesis.certificate import power_of_2

ALONE = "observer"  # label of an observer that is computed separately
PACKETS = 8  # ring size of grid points with no more packets; at an event the whole ring is processed
WINDOW = 8 * MANY  # realisations planned before incomplete batches are computed


class MomentRequest(NamedTuple):
    """What to compute for all grid points of a study."""

    root_seed: int
    schedules: int  # realisations of a random grid point: the first seeds
    record: str = ""  # nothing, "std" or "covariance" over time
    points: int = 0  # approximate number of recorded ticks; 0: every tick

    def interval(self, ticks: int) -> int:
        """Return the recording interval in ticks."""
        return max(1, ticks // self.points) if self.points else 1


class CellMoments(NamedTuple):
    """The moments of one planned grid point; S realisations (1 if only the noise is random)."""

    plan: Plan  # without its long tables
    random: bool  # runs have different schedules
    signals: dict[str, slice]  # by observer label, its slice of the Z signals
    sums: Sums  # arrays [..., S]
    rows: MomentRecord | tuple[()] = ()  # [..., S]
    final_errors: dict[str, FinalErrors] = {}  # by observer label, of a study that asks for consistency  # noqa: RUF012
    mixture: bool = False  # over losses or delays: means and squares are exact, distributions are not normal
    why: dict[str, str] = {}  # by observer label, why it has no exact answer, empty: it has (`exactness`)  # noqa: RUF012
    final_state: Numbers | tuple[()] = ()  # [2, n, S] as in `Outcome`
    # [S] probabilities of the modes in `final_errors`; None: realisations have equal weight
    mode_probabilities: NDArray[np.float64] | None = None
    refusal: str = ""  # clause why there are no exact moments, if that is known without them


class Work(NamedTuple):
    """A planned grid point, its realisations, and the calls that compute them."""

    plan: Plan
    realisations: list[Realisation]  # empty if there are no exact moments
    random: bool
    trial: bool  # whether drawn schedules may still be needed after these
    curvature: float
    calls: list[tuple[Future[Outcome], int]]  # with the index of each realisation in its call
    refusal: str  # clause why there are no exact moments, if that is known without them


def plan_cells(cells: list[Cell], joint: bool = False) -> Iterator[Plan]:
    """Yield grid points ready to run, one per observer unless `joint`.

    They have one of two ring sizes, for few programs. If noise reaches packets in flight, the ring has the size that the grid
    point needs, as the covariance covers the whole ring.
    """
    packets_of = cache(random_times.room)

    def ring(cell: Cell) -> int:  # an upper limit of the packets in flight, for any draws
        return packets_of(tuple(cell.times.clocks), cell.times.ticks, cell.times.error)

    most = max(map(ring, cells))
    least = PACKETS if len(cells) > WINDOW else most  # with this many grid points another program pays off
    for p in padding.check_drafts(drafts(cells)):
        capacity, packets = padding.capacity_of(p), ring(p.cell)
        plan = padding.fit_to_capacity(p, capacity)  # a closed loop gets its controller's parameters here
        layout = plan.layout
        places = power_of_2(packets if _noise_in_flight(plan) else most if packets > least else min(most, least))
        layout = layout._replace(ring=max(capacity.ring, places))
        if joint:
            yield plan._replace(layout=layout)
            continue
        for label, (name, observer) in zip(p.labels, layout.observers, strict=True):
            problem = plan.problem._replace(gains={ALONE: plan.problem.gains[name]})
            single = layout._replace(observers=((ALONE, observer),))
            yield plan._replace(layout=single, problem=problem, labels=(label,))


def _noise_in_flight(p: Plan) -> bool:
    """Return whether noise reaches packets in flight, in addition to the noise of the samples."""
    drifting = p.layout.drifting and p.layout.plant.of_run is None  # else a realisation has fixed plant parameters
    return form_of(p.layout._replace(drifting=drifting), p.problem).flight


def solve(plans: Iterable[Plan], request: MomentRequest) -> Iterator[CellMoments]:
    """Yield the moments of each planned grid point, in order."""
    unmergeable, wide = set[Hashable](), set[Hashable]()  # local: earlier results must not change any bit
    with thread_pools.pool(runner.cores()) as threads:
        previous: list[Work] = []
        for window in _windows(plans, request, unmergeable):
            _submit(threads, window, request, wide)
            yield from (_moments(work, request, unmergeable) for work in previous)
            previous = window
        yield from (_moments(work, request, unmergeable) for work in previous)


def _windows(plans: Iterable[Plan], request: MomentRequest, unmergeable: set[Hashable]) -> Iterator[list[Work]]:
    """Yield grid points with their realisations, one window at a time; kinds in `unmergeable` do not use modes."""
    window: list[Work] = []
    count = 0  # realisations in the window
    for p in plans:
        curvature = plant_curvature(p)
        reason = refusal_beforehand(p)
        may_be_exact = not (reason or curvature > ROUNDING)
        realisations, is_drawn, trial = _realisations(p, request, unmergeable) if may_be_exact else ([], False, False)
        window.append(Work(p, realisations, is_drawn, trial, curvature=curvature, calls=[], refusal=reason))
        count += len(realisations)
        if count >= WINDOW:
            yield window
            window, count = [], 0
    yield window


def _realisations(p: Plan, request: MomentRequest, unmergeable: set[Hashable]) -> tuple[list[Realisation], bool, bool]:
    """Return the realisations of a grid point, whether schedules are drawn, and whether this is a trial.

    There is one realisation, one per mode, or one per drawn schedule. A trial has only the first drawn schedule.
    """
    is_single = len(p.layout.observers) == 1
    if is_single and _kind(p) not in unmergeable and (modes := realisations_over_modes(p)):
        return modes, False, True
    if is_single and only_losses_random(p) and (realisation := realisation_over_losses(p)):
        return [realisation], False, False
    first, is_drawn = draw_realisation(p, request.root_seed, 0), is_random(p)
    if is_single and is_drawn and request.schedules > 1 and is_curved(first.layout, first.problem):
        return [first], True, True
    return [first, *_draw_realisations(p, request, 1)], is_drawn, False


def _draw_realisations(p: Plan, request: MomentRequest, first: int) -> list[Realisation]:
    """Return a random grid point on its drawn schedules, from seed `first` on."""
    seeds = range(first, request.schedules) if is_random(p) else ()
    return [draw_realisation(p, request.root_seed, seed) for seed in seeds]


def _kind(p: Plan) -> Hashable:
    """Return the key that decides whether modes can merge: the observer, without its numbers."""
    return p.layout.observers, jax.tree.structure(p.problem)


def _submit(threads: ThreadPoolExecutor, window: list[Work], request: MomentRequest, wide: set[Hashable]) -> None:
    """Submit the realisations of some grid points, grouped by kind; all modes of a grid point share a call."""
    groups: dict[Hashable, list[tuple[Work, Realisation]]] = {}
    digests: dict[int, Hashable] = {}

    def call(group: list[tuple[Work, Realisation]]) -> None:
        realisations = [realisation for _, realisation in group]
        future = threads.submit(runner.in_float64, _compute, realisations, request, width_of(realisations, wide))
        for at, (work, _) in enumerate(group):
            work.calls.append((future, at))

    for work in window:
        count = len(work.realisations) if work.realisations and work.realisations[0].mode else 1
        for first in range(0, len(work.realisations), count):
            member = work.realisations[first]
            key = member.layout, batch_key(member.problem, digests), member.mode is not None
            if len(groups.get(key, [])) + count > MANY:
                call(groups.pop(key))
            groups.setdefault(key, []).extend(
                (work, realisation) for realisation in work.realisations[first : first + count]
            )
    for group in groups.values():
        call(group)


def _compute(realisations: list[Realisation], request: MomentRequest, width: int | None = None) -> Outcome:
    return compute(realisations, request.record, request.interval(int(realisations[0].problem.windows[-1, 1])), width)


def _moments(work: Work, request: MomentRequest, unmergeable: set[Hashable]) -> CellMoments:
    """Return the moments of a grid point, on all drawn schedules if a trial gave no answer."""
    p = work.plan
    if not work.realisations:
        return _gather(work, [Outcome(nan_sums(sum(_signals(p).values()), work.curvature), ())])
    outcomes = [jax.tree.map(lambda a, at=at: a[..., at : at + 1], future.result()) for future, at in work.calls]
    if work.trial and not _is_sufficient(work, outcomes):
        if work.realisations[0].mode:
            unmergeable.add(_kind(p))
        work, outcomes = work._replace(realisations=_draw_realisations(p, request, 0), random=True), []
        for first in range(0, len(work.realisations), MANY):
            realisations = work.realisations[first : first + MANY]
            outcome, count = runner.in_float64(_compute, realisations, request), len(realisations)
            outcomes.append(jax.tree.map(lambda a, count=count: a[..., :count], outcome))
    return _gather(work, outcomes)


def _is_sufficient(work: Work, outcomes: list[Outcome]) -> bool:
    """Return whether the results are sufficient: the modes merged consistently, or the trial showed that nothing is exact."""
    if work.realisations[0].mode:
        return bool(max(np.max(outcome.mode_difference) for outcome in outcomes) <= ROUNDING)
    (outcome,) = outcomes
    return bool((relative_deviation(outcome.sums, slice(None), outcome.final_state) > ROUNDING).any())


def nan_sums(signals: int, curvature: float) -> Sums:
    """Return the sums of a grid point that was not computed: only its deviation from affine."""
    nan: Sums = jax.tree.map(lambda a: np.full(a.shape, np.nan), zero_sums(signals, 0, 1))
    return nan._replace(deviation=np.full((signals, 1), curvature), size=np.ones((signals, 1)))


def _gather(work: Work, outcomes: list[Outcome]) -> CellMoments:
    """Return the moments of one grid point from its realisations."""
    p, modes = work.plan, [realisation.mode for realisation in work.realisations if realisation.mode]
    outcome: Outcome = jax.tree.map(lambda *a: np.concatenate(a, -1), *outcomes) if len(outcomes) > 1 else outcomes[0]
    mode_probabilities = np.array([mode.probability for mode in modes]) if modes else None
    labels = dict(zip((name for name, _ in p.layout.observers), p.labels, strict=True))
    first, signals = 0, {}
    for name, count in sorted(_signals(p).items()):
        signals[labels[name]] = slice(first, first + count)
        first += count
    n, final_errors = len(p.problem.x0), {}
    if outcome.final:
        for name, P in outcome.final.assumed.items():
            states = slice(signals[labels[name]].start, signals[labels[name]].start + n)
            true = np.asarray(outcome.sums.mean[states]), np.asarray(outcome.final.covariance[states, states])
            final_errors[labels[name]] = FinalErrors(*true, np.asarray(P[:n, :n]), np.diagonal(p.problem.spread0))
    total = outcome if mode_probabilities is None else _average_modes(outcome, mode_probabilities)
    return CellMoments(
        plan=p._replace(problem=p.problem._replace(schedule=(), inputs=(), params=(), gains={})),
        random=work.random,
        signals=signals,
        sums=total.sums,
        rows=total.rows,
        final_errors=final_errors,
        mixture=mode_probabilities is not None or any(realisation.chance < 1 for realisation in work.realisations),
        final_state=outcome.final_state,
        mode_probabilities=mode_probabilities,
        refusal=work.refusal,
    )


def _signals(p: Plan) -> dict[str, int]:
    """Return the number of signals that each observer of a planned grid point estimates."""
    n, user_defined = len(p.problem.x0), p.layout.plant.scored
    if n + user_defined == len(p.problem.band):
        return {name: n + user_defined for name, _ in p.layout.observers}

    def estimates(problem: GridPointParams) -> dict[str, Array]:
        gains, xhat0 = problem.gains, problem.xhat0
        return {name: o.estimate(gains[name], o.init(gains[name], xhat0)) for name, o in p.layout.observers}

    return {name: e.shape[0] + user_defined for name, e in jax.eval_shape(estimates, p.problem).items()}


def _average_modes(outcome: Outcome, mode_probabilities: NDArray[np.float64]) -> Outcome:
    """Return the results of M modes [..., M] as one, [..., 1], weighted by probability; assumed covariances stay per mode.

    A sum over ticks is the mean of the modes' sums, as mode probabilities are constant. A variance includes the variance of the
    means between modes.
    """

    def mean(a: Numbers) -> Numbers:
        return (a @ mode_probabilities)[..., None]

    s: Sums = jax.tree.map(mean, outcome.sums)
    std = np.sqrt(mean(np.square(outcome.sums.std) + np.square(outcome.sums.mean - s.mean)))
    worst = {name: getattr(outcome.sums, name).max(-1, keepdims=True) for name in ("reach", "deviation", "size")}
    rows = outcome.rows
    if rows:
        mixed_mean = mean(rows.mean)
        difference, has_covariance = rows.mean - mixed_mean, rows.covariance.shape[2] > 1
        between = difference[:, :, None] * difference[:, None] if has_covariance else np.square(difference)[:, :, None]
        rows = MomentRecord(mixed_mean, mean(rows.covariance + between))
    return outcome._replace(sums=s._replace(std=std, **worst), rows=rows)
