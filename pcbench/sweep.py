"""From a study to numbers: plan every cell, run its seeds in blocks, collect what each run leaves.

All cells of a plant and horizon share one compiled program: the ring and the arrival slots are sized for the largest.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from pcbench import conformance, ensemble, metrics, sampling
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.rollout import Layout, Problem
from pcbench.signals import SIGNALS
from pcbench.study import Cell, Study, cells, observers_of, options_of
from pcbench.synthesis import linear, riccati
from pcbench.synthesis.certificate import Certificate, Design, Setting


class Planned(NamedTuple):
    """A cell ready to run."""

    cell: Cell
    layout: Layout
    problem: Problem
    certificates: dict[str, Certificate]
    bound: NDArray[np.float64] | None  # [n] root-mean-square over the tail that no causal estimator beats, where known


class Done(NamedTuple):
    """A cell with what its runs left: by observer, metric -> [n, seeds] ([seeds] for divergence)."""

    planned: Planned
    seeds: NDArray[np.int64]
    results: dict[str, dict[str, NDArray[Any]]]


def ticks(cell: Cell) -> int:
    """Return the horizon N in ticks."""
    return round(cell.scenario.horizon / cell.scenario.dt)


def tail_tick(cell: Cell) -> int:
    """Return the tick at which the tail starts."""
    return round(cell.scenario.tail / cell.scenario.dt)


def setting(cell: Cell) -> Setting:
    """Return what a designer is told: the nominal model, whatever the axes do to the plant."""
    s, plant = cell.scenario, PLANTS[cell.scenario.plant]

    def whole(seconds: tuple[float, ...]) -> tuple[int, ...]:
        return tuple(round(v / s.dt) for v in seconds)

    return Setting(
        s.name,
        plant.nominal(plant.numbers),
        s.dt,
        ticks(cell),
        whole(s.sampling_period),
        whole(s.delay),
        s.noise_std,
        np.diag(np.square(s.prior_std)),
        s.drift_intensity if s.drift else 0.0,
    )


def plan(study: Study) -> list[Planned]:
    """Design every observer of every cell and lay out its numbers; raise UserError where a gain is not certified."""
    drafts = []
    for name in study.scenarios:
        for cell in cells(study, name):
            options = {o: options_of(study, cell.scenario, o) for o in observers_of(study, name)}
            drafts.append(draft(cell, options))
    return fit(drafts)


def fit(drafts: list[Planned]) -> list[Planned]:
    """Give drafts one shape: arrival slots and room on the network for the largest of them."""
    seen: set[Any] = set()
    for p in drafts:
        for label, observer in p.layout.observers:
            if (key := (label, p.layout.plant)) not in seen:
                seen.add(key)
                conformance.check(label, observer, p.problem)
    slots = max(p.problem.schedule.arrive.shape[1] for p in drafts)
    room = max(sampling.in_flight(p.problem.schedule) for p in drafts)
    ring = 1 << (room - 1).bit_length()  # few sizes, few programs
    out = []
    for p in drafts:
        problem = p.problem._replace(schedule=sampling.pad_slots(p.problem.schedule, slots))
        out.append(p._replace(problem=problem, layout=p.layout._replace(ring=ring)))
    return out


def draft(cell: Cell, options: dict[str, BaseModel]) -> Planned:
    """Lay out one cell for the observers that `options` names; its layout does not yet fit others."""
    s, known = cell.scenario, setting(cell)
    plant, n = PLANTS[s.plant], ticks(cell)
    designs = {o: _design(o, known, given) for o, given in options.items()}
    numbers = plant.numbers._replace(**cell.parameters, drift=s.drift, drift_sign=float(cell.choices.drift_sign))
    problem = Problem(
        params=plant.prepare(numbers, s.dt, n),
        gains={o: d.gains for o, d in designs.items()},
        schedule=sampling.periodic(list(known.period), list(known.delay), n),
        inputs=SIGNALS[s.input](s.dt * np.arange(n + 1, dtype=float)),
        dt=np.asarray(s.dt),
        x0=np.array(s.x0),
        xhat0=np.array(s.xhat0),
        spread0=np.diag(s.prior_std),
        noise_std=np.array(s.noise_std),
        band=np.array(s.settle_band),
        bound=np.asarray(s.bound),
        windows=np.array([[0, tail_tick(cell)], [tail_tick(cell), n - 1], [n - 1, n]]),
    )
    observers = tuple((o, OBSERVERS[o].observer) for o in options)
    layout = Layout(plant.plant, observers, ensemble.WIDTH, 1, cell.choices.random_start)
    return Planned(cell, layout, problem, {o: d.certificate for o, d in designs.items()}, _bound(cell, known))


def _design(observer: str, known: Setting, options: BaseModel) -> Design:
    found = OBSERVERS[observer].design(known, options)
    if not isinstance(found, Design) or not isinstance(found.certificate, Certificate):
        raise UserError(
            f"observer {observer}: design returned {type(found).__name__}, expected Design(gains, Certificate)."
        )
    return found


def _bound(cell: Cell, known: Setting) -> NDArray[np.float64] | None:
    """The Bayesian bound over the tail; it exists for the true linear model, measurement noise and no other noise."""
    exact = not cell.scenario.drift and not cell.parameters and all(known.noise_std)  # no bound without noise
    if not exact or len(set(known.period)) > 1 or len(set(known.delay)) > 1:
        return None
    doubled = linear.doublings(known.model.A, known.dt, linear.bits_for(known.ticks))
    R = np.diag(np.square(known.noise_std))
    variance = riccati.posterior_variance(
        doubled, known.model.C, R, known.P0, known.period[0], known.delay[0], known.ticks
    )
    return np.sqrt(variance[tail_tick(cell) :].mean(0))


def blocks(planned: Planned, root_seed: int, seeds: NDArray[np.int64]) -> Iterator[ensemble.Job]:
    """Cut a cell's seeds into jobs of one width."""
    for first in range(0, len(seeds), planned.layout.width):
        yield ensemble.Job(planned.problem, root_seed, seeds[first : first + planned.layout.width])


def execute(
    study: Study,
    planned: list[Planned],
    seeds: NDArray[np.int64] | None = None,
    devices: int | None = None,
    tell: Callable[[str, float], None] = lambda event, value: None,
) -> Iterator[Done]:
    """Run every planned cell and yield it when its last run is in.

    `seeds` are seed indices, by default 0 .. study.seeds - 1. `tell` hears ("compiled", seconds) and ("runs", how many).
    """
    chosen = np.arange(study.seeds) if seeds is None else np.asarray(seeds)
    for layout, group in _by_layout(planned):
        jobs = [(p, job) for p in group for job in blocks(p, study.root_seed, chosen)]
        collected: dict[str, list[dict[str, NDArray[Any]]]] = {}
        made = ensemble.program(layout, jobs[0][1], devices)
        tell("compiled", made.compile_seconds)
        outcomes = ensemble.run(made, (job for _, job in jobs))
        for i, ((p, _), (job, outcome)) in enumerate(zip(jobs, outcomes, strict=True)):
            for label, _ in layout.observers:
                n, tail, dt = ticks(p.cell), tail_tick(p.cell), p.cell.scenario.dt
                read = metrics.read(outcome.streams[label], outcome.watches[label], outcome.final[label], n, tail, dt)
                collected.setdefault(label, []).append(read)
            tell("runs", len(job.seeds) * len(layout.observers))
            if i + 1 == len(jobs) or jobs[i + 1][0] is not p:
                yield Done(p, chosen, {label: _concatenate(parts) for label, parts in collected.items()})
                collected = {}


def _by_layout(planned: list[Planned]) -> Iterator[tuple[Layout, list[Planned]]]:
    groups: dict[Any, list[Planned]] = {}
    for p in planned:
        groups.setdefault((p.layout, ticks(p.cell)), []).append(p)
    for (layout, _), group in groups.items():
        yield layout, group


def _concatenate(parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([part[name] for part in parts], -1) for name in parts[0]}
