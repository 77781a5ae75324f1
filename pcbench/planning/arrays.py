"""From a study to what is simulated: gains, inputs, schedules and bounds as arrays, one draft a cell."""

from collections.abc import Container, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from pcbench.errors import UserError
from pcbench.observers import base_of, entry_of
from pcbench.planning import controller, padding
from pcbench.planning.design_setting import setting
from pcbench.planning.least_error import bound
from pcbench.planning.padding import Planned
from pcbench.plants import PLANTS, numbers_of
from pcbench.scenarios.signals import SINGLE, inputs, jumps
from pcbench.simulation import batch
from pcbench.simulation.problem import Layout, Problem
from pcbench.simulation.schedule import per_lane, shared
from pcbench.study import Study, observers_of, options_of
from pcbench.study.cells import Cell, cells_of, identity, told
from pcbench.synthesis.certificate import Certificate, Design, Setting


def plan(study: Study) -> list[Planned]:
    """Design every observer of every cell and lay out its numbers; raise UserError where a gain is not certified."""
    return padding.fit(list(drafts(study, cells_of(study))))


def drafts(study: Study, every: list[Cell], wanted: Container[tuple[str, int]] | None = None) -> Iterator[Planned]:
    """Draft cells one after another: of each one draft, or in a closed loop one for every observer, each with its own plant.

    Cells whose key is not `wanted` (None: all are) have no gains: they say what room a program needs.
    """
    most: dict[str, tuple[int, int]] = {}
    for cell in every:
        if not cell.times.random:
            known, plant = setting(cell), cell.scenario.plant
            overtaking, reach = most.get(plant, (0, 0))
            most[plant] = max(overtaking, known.overtaking), max(reach, known.reach)
    for cell in every:
        known = setting(cell)
        if not cell.times.random:  # where sampling is random, room for more costs more than a program
            overtaking, reach = most[cell.scenario.plant]
            known = known._replace(overtaking=overtaking, reach=reach)
        options = {o: options_of(study, cell.scenario, o) for o in observers_of(study, cell.scenario.name)}
        for each in [{o: given} for o, given in options.items()] if cell.scenario.controller else [options]:
            drafted = draft(cell, each if wanted is None or cell.key in wanted else {}, known)
            yield drafted._replace(digest=identity(cell, study.root_seed))


def width(cell: Cell) -> int:
    """Return the lanes of a call."""
    return batch.HEAVY if PLANTS[cell.scenario.plant].heavy else batch.WIDTH


def draft(cell: Cell, options: dict[str, BaseModel], known: Setting | None = None) -> Planned:
    """Lay out one cell for the observers that `options` names; its layout does not yet fit others."""
    s, known = cell.scenario, known or setting(cell)
    plant, n = PLANTS[s.plant], cell.times.ticks
    designs = {o: _design(o, known, given) for o, given in options.items()}
    names = {o: (base_of(o) or o) if s.controller else o for o in options}
    truth = {"drift": s.drift} | cell.parameters
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
        windows=np.array([[0, cell.times.tail], [cell.times.tail, n - 1], [n - 1, n]]),
        process_std=np.array(s.process_std),
        jumps=np.array([tick for tick in jumps(s.unknown_input, s.dt, n - 1) if tick >= cell.times.tail], int),
        scatter=np.array(s.start_box) * around,
    )
    observers = tuple((names[o], entry_of(o).observer) for o in options)
    random = drawn or cell.choices.start_spread > 0
    drifting = bool(s.drift and plant.plant.of_run)
    layout = Layout(
        plant.plant,
        observers,
        width(cell),
        room,
        random,
        strides=_strides(plan, options, plant.heavy),
        continuous=s.continuous,
        drifting=drifting,
        controller=controller.controller(cell),
        scattered=bool(s.start_box),
    )
    proofs, carries = {o: d.certificate for o, d in designs.items()}, {o: d.carries_input for o, d in designs.items()}
    reach = controller.reach(cell, known.overtaking, n) if s.controller else None
    least = bound(cell, known) if options else None
    digests = {o: told(given) for o, given in options.items()}
    return Planned(cell, layout, problem, proofs, least, carries, tuple(options), reach, digests)


def _strides(plan: Any, options: dict[str, BaseModel], heavy: bool) -> bool:
    """Whether flow goes by two ticks: not where nearly every tick has an event, nor where bodies are long to compile."""
    dense = isinstance(plan, shared.Schedule) and plan.event.mean() >= 0.5
    return not (dense or heavy or any(entry_of(o).heavy for o in options))


def _inputs(cell: Cell, known: Setting) -> NDArray[np.float64]:
    """The input of an open loop, [N+1, m]; where a controller gives it, one row of NaN: nothing may read it."""
    s, m = cell.scenario, known.model.B.shape[1]
    if s.controller:
        return np.full((1, m), np.nan)
    u = inputs(s.input, s.dt * np.arange(cell.times.ticks + 1, dtype=float), m)
    if u.shape[1] != m:
        raise UserError(
            f"{s.name}: got the input '{s.input}', which has {u.shape[1]} columns, expected one signal, or one for each of the "
            f"plant's {m} inputs with commas between; take one of {', '.join(SINGLE)}."
        )
    return u


def schedule_of(cell: Cell, run: tuple[int, int] | None = None) -> tuple[Any, int]:
    """Return a cell's schedule and the packets it needs room for; of one run (root seed, seed), where it is random."""
    s, clocks, n = cell.scenario, cell.times.clocks, cell.times.ticks
    error, channels = cell.times.error, len(s.delay)
    if s.continuous:
        return shared.at_every_tick(n, channels), 1
    if cell.times.random and run is None:
        return per_lane.times(clocks, n, channels, error), per_lane.room(clocks, n, error)
    found = per_lane.realised(clocks, n, channels, *run) if run and cell.times.random else shared.samples(clocks, n)
    plan = shared.schedule(found, n, channels, error)
    return plan, shared.in_flight(plan)


def _design(observer: str, known: Setting, options: BaseModel) -> Design:
    found = entry_of(observer).design(known, options)
    if not isinstance(found, Design) or not isinstance(found.certificate, Certificate):
        raise UserError(
            f"observer {observer}: design returned {type(found).__name__}, expected Design(gains, Certificate)."
        )
    return found


def alone(p: Planned, root_seed: int, seed: int) -> Planned:
    """Return a cell laid out for one run: where sampling is random, on the schedule of that run."""
    plan, room = schedule_of(p.cell, (root_seed, seed))
    return p._replace(
        problem=p.problem._replace(schedule=plan), layout=p.layout._replace(ring=max(room, p.layout.ring))
    )
