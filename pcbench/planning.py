"""From a study to numbers ready to run: every cell with its gains, its schedule and its bound.

All cells of a plant and horizon share one compiled program: the ring and the arrival slots are sized for the largest.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax.tree_util import Partial
from numpy.typing import NDArray
from pydantic import BaseModel

from pcbench import axes, closed_loop, conformance, ensemble, irregular, sampling
from pcbench.cells import Cell, cells
from pcbench.errors import UserError
from pcbench.observers import base_of, entry_of
from pcbench.plants import PLANTS, nonlinear, numbers_of
from pcbench.problem import Layout, Problem
from pcbench.signals import SINGLE, inputs, jumps
from pcbench.study import Study, observers_of, options_of
from pcbench.synthesis import linear, riccati
from pcbench.synthesis.certificate import Certificate, Design, Setting


class Planned(NamedTuple):
    """A cell ready to run."""

    cell: Cell
    layout: Layout
    problem: Problem
    certificates: dict[str, Certificate]
    bound: NDArray[np.float64] | None  # [n] root-mean-square over the tail that no causal estimator beats, where known
    carries_input: dict[str, bool | None]  # by observer, of its prediction to now
    labels: tuple[str, ...]  # of the layout's observers; they go by their base in a closed loop, to share a program
    reach: closed_loop.Reach | None  # of a closed loop


def ticks(cell: Cell) -> int:
    """Return the horizon N in ticks."""
    return round(cell.scenario.horizon / cell.scenario.dt)


def tail_tick(cell: Cell) -> int:
    """Return the tick at which the tail starts."""
    return round(cell.scenario.tail / cell.scenario.dt)


def setting(cell: Cell) -> Setting:
    """Return what a designer is told: the nominal model and the believed delay, whatever is true of the plant."""
    s, clocks, n = cell.scenario, axes.clocks(cell.scenario), ticks(cell)
    period, delay = [0] * len(s.delay), [0] * len(s.delay)
    plant, many = PLANTS[s.plant], len(s.unknown_std)
    params = plant.prepare(numbers_of(s), s.dt, n) if plant.model else None
    for clock in clocks:
        for j in clock.channels:
            if isinstance(clock.profile, tuple):
                period[j] = round(sum(clock.profile) / len(clock.profile))
            else:
                period[j] = clock.period
            late = period[j] if clock.delay is None else clock.delay
            delay[j] = late + clock.spread // 2 + round(s.assumed_delay_error / s.dt)
    return Setting(
        s.name,
        plant.nominal(numbers_of(s)),
        s.dt,
        n,
        tuple(period),
        tuple(delay),
        tuple(std or spare for std, spare in zip(s.noise_std, s.assumed_noise_std or s.noise_std, strict=True)),
        np.diag(np.square(s.prior_std)),
        s.drift_intensity if s.drift else 0.0,
        _overtaking(clocks, n),
        s.process_std or s.assumed_process_std,
        round(s.assumed_delay_error / s.dt),
        max(-(-late // every) for late, every in zip(delay, period, strict=True)),
        s.unknown_std,
        s.unknown0 or (0.0,) * many,
        plant.ranges or ((-np.inf, np.inf),) * many,
        Partial(plant.model, params) if plant.model else None,
        Partial(plant.parts, params) if plant.parts else None,
        tuple(sampling.intervals(clocks[0], n)) if len(clocks) == 1 else (),
    )


def _overtaking(clocks: list[sampling.Clock], ticks: int) -> int:
    """How many newer samples may arrive before one; of one clock with samples of one age, none."""
    if _random(clocks):
        return irregular.overtaking(clocks, ticks)
    alone = len(clocks) == 1 and clocks[0].delay is not None and not any(clocks[0].swing)
    return 0 if alone else sampling.overtaking(sampling.samples(clocks, ticks))


def _random(clocks: list[sampling.Clock]) -> bool:
    return any(clock.random for clock in clocks)


def plan(study: Study) -> list[Planned]:
    """Design every observer of every cell and lay out its numbers; raise UserError where a gain is not certified."""
    every = [cell for name in study.scenarios for cell in cells(study, name)]
    drafts = []
    for cell, known in zip(every, _one_room([(cell, setting(cell)) for cell in every]), strict=True):
        options = {o: options_of(study, cell.scenario, o) for o in observers_of(study, cell.scenario.name)}
        loops = [{o: given} for o, given in options.items()] if cell.scenario.controller else [options]
        drafts += [draft(cell, each, known) for each in loops]  # in a closed loop every observer has its own plant
    return fit(drafts)


def _one_room(each: list[tuple[Cell, Setting]]) -> list[Setting]:
    """Give all cells of a plant the room in memories that the largest needs: they share one program.

    Only cells whose sampling is the same for all runs: where it is random, room for more overtaking costs more than a program.
    """
    most: dict[str, tuple[int, int]] = {}
    for cell, known in each:
        if not _random(axes.clocks(cell.scenario)):
            overtaking, reach = most.get(cell.scenario.plant, (0, 0))
            most[cell.scenario.plant] = max(overtaking, known.overtaking), max(reach, known.reach)
    out = []
    for cell, known in each:
        if not _random(axes.clocks(cell.scenario)):
            overtaking, reach = most[cell.scenario.plant]
            known = known._replace(overtaking=overtaking, reach=reach)
        out.append(known)
    return out


def fit(drafts: list[Planned]) -> list[Planned]:
    """Give drafts one shape: arrival slots and room on the network for the largest of them."""
    seen: set[Any] = set()
    for p in drafts:
        for label, observer in p.layout.observers:
            if (key := (label, p.layout.plant, p.layout.continuous)) not in seen:
                seen.add(key)
                conformance.check(label, observer, p.problem, p.layout.continuous)
    return _same_shapes(drafts)


def _same_shapes(drafts: list[Planned]) -> list[Planned]:
    """Give every cell the arrival slots, the room on the network and the rows of the plant that the largest needs."""
    shared = [p.problem.schedule for p in drafts if isinstance(p.problem.schedule, sampling.Schedule)]
    slots = max((plan.arrive.shape[1] for plan in shared), default=1)
    most = max(
        (_times(p).due.shape[1] for p in drafts if not isinstance(p.problem.schedule, sampling.Schedule)), default=0
    )
    ring = _rounded(max(p.layout.ring for p in drafts))
    early = _rounded(max((len(plan.early) for plan in shared), default=0))
    strides = any(not isinstance(p.problem.schedule, sampling.Schedule) or _sparse(p.problem.schedule) for p in drafts)
    drifting = {p.layout.plant for p in drafts if p.layout.drifting}
    loops = [p.reach for p in drafts if p.reach]
    reach = closed_loop.Reach(*(_rounded(max(each)) for each in zip(*loops, strict=True))) if loops else None
    falls = max(len(p.problem.jumps) for p in drafts)
    rows: dict[Any, int] = {}
    for p in drafts:
        for i, a in enumerate(jax.tree.leaves(p.problem.params)):
            key = (p.layout.plant, i)
            rows[key] = max(rows.get(key, 0), len(a) if np.ndim(a) else 0)
    out = []
    for p in drafts:
        plan = p.problem.schedule
        if isinstance(plan, sampling.Schedule):
            plan = sampling.pad_early(sampling.pad_slots(plan, slots), early)
        else:
            plan = irregular.padded(plan, most)
        leaves, tree = jax.tree.flatten(p.problem.params)
        wide = [
            np.broadcast_to(a, (rows[p.layout.plant, i], *np.shape(a)[1:])) if np.ndim(a) and len(a) == 1 else a
            for i, a in enumerate(leaves)
        ]
        falling = np.pad(p.problem.jumps, (0, falls - len(p.problem.jumps)), constant_values=sampling.NEVER)
        problem = p.problem._replace(schedule=plan, params=jax.tree.unflatten(tree, wide), jumps=falling)
        if reach and p.reach:
            law, line = closed_loop.close(p.cell, reach, ticks(p.cell))
            problem = problem._replace(control=law, line=line)
        heavy = PLANTS[p.cell.scenario.plant].heavy or any(entry_of(label).heavy for label, _ in p.layout.observers)
        layout = p.layout._replace(ring=ring, strides=strides and not heavy, drifting=p.layout.plant in drifting)
        layout = layout._replace(commands=reach.back if reach and p.reach else 0)
        out.append(p._replace(problem=problem, layout=layout))
    return out


def _rounded(many: int) -> int:
    """The next power of 2: few sizes, few programs."""
    return 1 << (many - 1).bit_length() if many else 0


def _sparse(plan: sampling.Schedule) -> bool:
    return bool(plan.event.mean() < 0.5)


def _times(p: Planned) -> irregular.Times:
    return p.problem.schedule


def draft(cell: Cell, options: dict[str, BaseModel], known: Setting | None = None) -> Planned:
    """Lay out one cell for the observers that `options` names; its layout does not yet fit others."""
    s, known = cell.scenario, known or setting(cell)
    plant, n = PLANTS[s.plant], ticks(cell)
    designs = {o: _design(o, known, given) for o, given in options.items()}
    names = {o: (base_of(o) or o) if s.controller else o for o in options}
    truth = {"drift": s.drift, "drift_sign": float(cell.choices.drift_sign)} | cell.parameters
    truth |= {"unknown_input": s.unknown_input} if s.unknown_input else {}
    drawn, around = cell.choices.random_start and not s.start_box, cell.choices.random_start and bool(s.start_box)
    spread = s.prior_std if drawn else cell.choices.start_spread * np.abs(s.x0)
    signals = len(s.x0) + len(s.unknown_std)
    plan, room = schedule_of(cell)
    problem = Problem(
        params=plant.prepare(numbers_of(s)._replace(**truth), s.dt, n),
        gains={names[o]: d.gains for o, d in designs.items()},
        schedule=plan,
        inputs=_inputs(cell, known),
        dt=np.asarray(s.dt),
        x0=np.array(s.xhat0 if drawn else s.x0),
        xhat0=np.array(s.x0 if around else s.xhat0),
        spread0=np.diag(spread),
        noise_std=np.array(s.noise_std),
        band=np.array(s.settle_band),
        bound=np.broadcast_to(np.asarray(s.bound, float), signals),
        windows=np.array([[0, tail_tick(cell)], [tail_tick(cell), n - 1], [n - 1, n]]),
        process_std=np.array(s.process_std),
        jumps=np.array([tick for tick in jumps(s.unknown_input, s.dt, n - 1) if tick >= tail_tick(cell)], int),
        scatter=np.array(s.start_box) * around,
    )
    observers = tuple((names[o], entry_of(o).observer) for o in options)
    random = drawn or cell.choices.start_spread > 0
    drifting = bool(s.drift and plant.plant.of_run)
    width = ensemble.HEAVY if plant.heavy else ensemble.WIDTH
    layout = Layout(
        plant.plant,
        observers,
        width,
        room,
        random,
        continuous=s.continuous,
        drifting=drifting,
        controller=closed_loop.controller(cell),
        scattered=bool(s.start_box),
    )
    proofs, carries = {o: d.certificate for o, d in designs.items()}, {o: d.carries_input for o, d in designs.items()}
    reach = closed_loop.reach(cell, known.overtaking, n) if s.controller else None
    return Planned(cell, layout, problem, proofs, _bound(cell, known), carries, tuple(options), reach)


def _inputs(cell: Cell, known: Setting) -> NDArray[np.float64]:
    """The input of an open loop, [N+1, m]; where a controller gives it, one row of NaN: nothing may read it."""
    s, m = cell.scenario, known.model.B.shape[1]
    if s.controller:
        return np.full((1, m), np.nan)
    u = inputs(s.input, s.dt * np.arange(ticks(cell) + 1, dtype=float), m)
    if u.shape[1] != m:
        raise UserError(
            f"{s.name}: got the input '{s.input}', which has {u.shape[1]} columns, expected one signal, or one for each of the "
            f"plant's {m} inputs with commas between; take one of {', '.join(SINGLE)}."
        )
    return u


def schedule_of(cell: Cell, run: tuple[int, int] | None = None) -> tuple[Any, int]:
    """Return a cell's schedule and the packets it needs room for; of one run (root seed, seed), where it is random."""
    s, clocks, n = cell.scenario, axes.clocks(cell.scenario), ticks(cell)
    error, channels = round(s.assumed_delay_error / s.dt), len(s.delay)
    if s.continuous:
        return sampling.at_every_tick(n, channels), 1
    if _random(clocks) and run is None:
        return irregular.times(clocks, n, channels, error), irregular.room(clocks, n, error)
    found = irregular.realised(clocks, n, channels, *run) if run and _random(clocks) else sampling.samples(clocks, n)
    plan = sampling.schedule(found, n, channels, error)
    return plan, sampling.in_flight(plan)


def _design(observer: str, known: Setting, options: BaseModel) -> Design:
    found = entry_of(observer).design(known, options)
    if not isinstance(found, Design) or not isinstance(found.certificate, Certificate):
        raise UserError(
            f"observer {observer}: design returned {type(found).__name__}, expected Design(gains, Certificate)."
        )
    return found


def _bound(cell: Cell, known: Setting) -> NDArray[np.float64] | None:
    """The Bayesian bound over the tail; it exists for the true linear model, a known schedule and noise on every output."""
    s = cell.scenario
    wrong = nonlinear(s.plant) or s.drift or cell.parameters or s.unknown_input
    exact = not wrong and all(s.noise_std)  # no bound without noise
    clocks = axes.clocks(cell.scenario)
    if not exact or _random(clocks):
        return None
    doubled = linear.doublings(known.model, known.dt, linear.bits_for(known.ticks))
    samples = [(s.arrives, s.taken, s.channel) for s in sampling.samples(clocks, known.ticks)]
    added = known._replace(process_std=s.process_std).process_noise  # what is, not what designers assume
    noise = linear.noise_doublings(known.model, added, known.dt, len(doubled))
    variance = riccati.posterior_variance(
        doubled, noise, known.model.C, known.noise_variance, known.P0, samples, known.ticks
    )
    return np.sqrt(variance[tail_tick(cell) :].mean(0))


def alone(p: Planned, root_seed: int, seed: int) -> Planned:
    """Return a cell laid out for one run: where sampling is random, on the schedule of that run."""
    plan, room = schedule_of(p.cell, (root_seed, seed))
    return p._replace(
        problem=p.problem._replace(schedule=plan), layout=p.layout._replace(ring=max(room, p.layout.ring))
    )
