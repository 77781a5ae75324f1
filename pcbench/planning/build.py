"""From a study to the arrays of a simulation: gains, inputs, schedules and bounds, one draft per grid point.

`bound` computes the smallest RMSE that any causal estimator can have at a grid point.
"""

from collections.abc import Callable, Container, Iterable, Iterator
from functools import partial
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from pcbench import plants
from pcbench.dynamics import linear
from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.observers import base_of
from pcbench.observers.parts import assumed_noise
from pcbench.planning import loop_setup, memo, operation_counts, padding, processor
from pcbench.planning.design_context import prepare_params, setting
from pcbench.planning.padding import AnySchedule, Plan
from pcbench.plants import differs, lti, nonlinear, numbers_of
from pcbench.scenarios.scenario import ProcessNoise, Sampling, per_channel
from pcbench.scenarios.signals import SINGLE, inputs, jumps
from pcbench.simulation.measurements import Outliers, Rounding, Trigger
from pcbench.simulation.schedule import common_times, random_times
from pcbench.simulation.types import GridPointParams, Layout
from pcbench.study import Study
from pcbench.study.grid import Cell, cells_of, identity, options_digest
from pcbench.study.times import times_of, to_ticks
from pcbench.synthesis import riccati
from pcbench.synthesis.certificate import DesignContext, power_of_2
from pcbench.toml_text import TomlTable
from pcbench.value_cache import key_of


def bound(cell: Cell, known: DesignContext, ask: memo.Once = memo.uncached) -> NDArray[np.float64] | None:
    """Return the Bayesian bound of the RMSE over the tail, [n], or None if it does not apply.

    It applies to the true linear model with a deterministic schedule, Gaussian noise and Gaussian initial states.
    """
    s = cell.scenario
    uncertain = (  # of the plant, or estimated
        nonlinear(s) or s.truth.parameter_drift or differs(numbers_of(s), cell.parameters),
        s.truth.unknown_input or s.loop.command_std or len(s.belief.unknown_std) > 0,
    )
    abnormal = (  # not Gaussian, or initial states not drawn from the prior
        not all(s.sampling.noise_std) or s.sampling.outlier_probability or np.isfinite(s.sampling.student_t_dof),
        any(s.sampling.quantization_step) or cell.choices.initial_spread,
        cell.choices.random_initial_state and s.belief.initial_box,
    )
    clocks = cell.times.clocks
    if any(uncertain) or any(abnormal) or cell.times.random:
        return None
    known = known._replace(noise_std=s.sampling.noise_std)  # the true value, not the assumed one
    alike = key_of((known.model, known.dt, known.noise_covariance, s.truth.process_std))
    key = alike, key_of((known.ticks, known.noise_covariance, known.P0, cell.times.tail)), tuple(clocks)
    steps = ask("steps", alike, riccati.no_steps)
    moved = ask("moved", (alike, known.ticks), lambda: _over_ticks(known, s.truth.process_std))

    def least() -> NDArray[np.float64]:
        _, C, R = assumed_noise.independent(known, None, known.model.C, known.scenario)
        samples = common_times.times_of_samples(clocks, known.ticks)
        tail = range(cell.times.tail, known.ticks)
        return np.sqrt(riccati.posterior_variance(*moved, C, R, known.P0, samples, tail, steps))

    return ask("bound", key, least)


def _over_ticks(known: DesignContext, process_std: ProcessNoise) -> tuple[linear.Matrix, linear.Matrix]:
    """Return the transition and the noise of the true model over 2^b ticks."""
    doubled = linear.doublings(known.model, known.dt, linear.bits_for(known.ticks))
    added = known._replace(process_std=process_std).process_noise
    return doubled, linear.noise_doublings(known.model, added, known.dt, len(doubled))


def plan(study: Study) -> list[Plan]:
    """Return the plan of every grid point with all designs and arrays; raise UserError if a gain is not certified."""
    return padding.fit(list(drafts(cells_of(study), runs=lambda cell: study.seeds)))


def drafts(
    every: list[Cell],
    wanted: Container[tuple[str, int]] | None = None,
    ask: memo.Once | None = None,
    runs: Callable[[Cell], int] | None = None,
    skip: int = 0,
    apart: bool = False,
) -> Iterator[Plan]:
    """Yield a draft of every grid point except the first `skip`; in a closed loop one per observer, as each has its own plant.

    If `apart`, each expensive observer also has its own draft. If processors have a limited speed, every observer does.

    Grid points whose key is not in `wanted` (None: all are) are drafted without gains, to find the room that a program needs.
    `ask` is a cache that grid points share. `runs` returns the number of runs of a grid point, which limits the width.
    """
    ask = ask or memo.once()
    most: dict[str, DesignContext] = {}
    limited = any(isfinite(cell.scenario.sampling.processor_speed) for cell in every)
    each = [_groups(cell, ask, limited, apart, wanted is None or cell.key in wanted) for cell in every]
    settings = [{tuple(own.times.clocks): setting(own, ask) for own, _ in groups} for groups in each]
    for cell, known in ((cell, known) for cell, found in zip(every, settings, strict=True) for known in found.values()):
        if not cell.times.random:
            most[cell.scenario.plant] = known.roomier(most.get(cell.scenario.plant, known))
    for groups, found in zip(each[skip:], settings[skip:], strict=True):
        for cell, options in groups:
            known = found[tuple(cell.times.clocks)]
            if cell.times.random:  # room for all would cost more than another program
                known = known._replace(spare=power_of_2(known.overtaking))
            else:
                known = known.roomier(most[cell.scenario.plant])
            p = draft(cell, options, known, ask)
            yield p._replace(layout=p.layout._replace(width=width(cell, runs(cell), options))) if runs else p


Group = tuple[Cell, dict[str, BaseModel]]


def _groups(cell: Cell, ask: memo.Once, limited: bool, apart: bool, asked: bool) -> list[Group]:
    """Return groups of observers that share a program: the grid point with the samples they can process, and their options.

    With a processor of limited speed (`limited`) no program is shared. If not `asked`, the options are empty.
    """
    alone = limited or bool(cell.scenario.loop.controller)
    own = [o for o in cell.options if alone or (apart and cell.entry(o).expensive)]  # each has its own program
    others = {o: given for o, given in cell.options.items() if o not in own}
    groups = [(cell, others), *((slowed(cell, o, ask), {o: cell.options[o]}) for o in own)]
    if not asked:
        return [(each, {}) for each, _ in (groups if limited else groups[:1])]
    return [group for group in groups if group[1]] or [(cell, {})]


def slowed(cell: Cell, label: str, ask: memo.Once = memo.uncached) -> Cell:
    """Return a grid point with the samples that an observer's processor has time for (`processor`)."""
    s, speed, usual = cell.scenario, cell.scenario.sampling.processor_speed, times_of(cell.scenario)
    if not isfinite(speed):
        return cell
    free = cell.having(processor_speed=inf)

    def count() -> Callable[[int, int], operation_counts.Cost]:
        p = draft(free, {label: cell.options[label]})
        return operation_counts.counter(p, *p.layout.observers[0])

    key = identity(free, 0), label, options_digest(cell.options[label], cell.own.get(label))
    load = processor.load_of(ask("counters", key, count), usual.clocks[0], usual.ticks, speed, s.dt)
    return cell._replace(times=processor.slowed(usual, load))


def width(cell: Cell, runs: int | None = None, labels: Iterable[str] = ()) -> int:
    """Return the runs per call, fewer if a light grid point has few `runs`; this does not change any bit of the results.

    Observers whose bits depend on the width have a fixed one (`ObserverSpec.lanes`). The definition has one width for all
    calls of a program with the observers `labels`.
    """
    if cell.engine == "definition":
        return runner.EXPENSIVE if any(cell.entry(label).expensive for label in labels) else runner.DEFINITION
    if fixed := [lanes for label in cell.options if (lanes := cell.entry(label).lanes)]:
        return min(fixed)
    most = runner.HEAVY if plants.entry_of(cell.scenario).heavy else runner.WIDTH
    if runs is None or cell.scenario.loop.controller or cell.times.random:
        return most
    return next((lanes for lanes in runner.NARROW if runs <= lanes < most), most)


def draft(
    cell: Cell, options: dict[str, BaseModel], known: DesignContext | None = None, ask: memo.Once = memo.uncached
) -> Plan:
    """Return the plan of one grid point for the observers in `options`; `padding.fit` gives it a common shape later."""
    s, known = cell.scenario, known or setting(cell, ask)
    true, belief, choices, measured = s.truth, s.belief, cell.choices, s.sampling
    plant, n = plants.entry_of(s), cell.times.ticks
    designs = {
        o: ask("designs", (cell.key, o), partial(memo.run_design, o, cell.entry(o), known, given))
        for o, given in options.items()
    }
    names = {o: (base_of(o) or o) if s.loop.controller else o for o in options}
    numbers: TomlTable = {"drift": true.parameter_drift} if "drift" in plant.numbers._fields else {}
    numbers |= cell.parameters
    if "sensor_delay" in plant.numbers._fields:  # of samples [s]; the mean if it varies
        clock = cell.times.clocks[0]
        numbers["sensor_delay"] = float((clock.period if clock.delay is None else clock.delay) + clock.later) * s.dt
    numbers |= {"unknown_input": true.unknown_input} if true.unknown_input else {}
    around = choices.random_initial_state and bool(belief.initial_box)
    drawn = choices.random_initial_state and not around
    chance, scale, step = measured.outlier_probability, measured.outlier_scale, measured.quantization_step
    outliers: Outliers | tuple[()] = ()
    if chance:
        many = len(measured.delay) if isinstance(chance, tuple) or isinstance(scale, tuple) else 0
        outliers = Outliers(*(np.asarray(per_channel(a, many) if many else a) for a in (chance, scale)))
    key = tuple(cell.times.clocks), n, cell.times.error, measured.continuous, len(measured.delay)
    schedule, room = ask("schedule", key, lambda: schedule_of(cell))
    problem = GridPointParams(
        params=prepare_params(plant, plants.replace_numbers(plants.numbers_of(s), numbers), s.dt, n, ask),
        gains={names[o]: d.gains for o, d in designs.items()},
        schedule=schedule,
        inputs=_inputs(cell, known, ask),
        dt=np.asarray(s.dt),
        x0=np.array(belief.xhat0 if drawn else true.x0),
        xhat0=np.array(true.x0 if around else belief.xhat0),
        spread0=np.diag(belief.prior_std if drawn else choices.initial_spread * np.abs(true.x0)),
        noise_std=np.array(measured.noise_std),
        band=np.array(s.scoring.settle_band),
        bound=np.broadcast_to(np.asarray(s.scoring.divergence_threshold, float), len(s.scoring.settle_band)),
        windows=np.array([[0, cell.times.tail], [cell.times.tail, n - 1], [n - 1, n]]),
        process_std=np.array(true.process_std),
        jumps=np.array([tick for tick in jumps(true.unknown_input, s.dt, n - 1) if tick >= cell.times.tail], int),
        scatter=np.array(belief.initial_box) * around,
        network=loop_setup.network(cell),
        weights=loop_setup.weights(cell),
        outliers=outliers,
        rounding=Rounding(np.array(step), np.asarray(measured.dither)) if any(step) else (),
        trigger=_trigger(measured),
        tail=np.asarray(dof) if np.isfinite(dof := measured.student_t_dof) else (),
        noise_root=np.linalg.cholesky(rho) if (rho := measured.noise_correlation) else np.zeros((0, 0)),
    )
    unlimited = (
        cell._replace(times=times_of(s)) if isfinite(measured.processor_speed) else cell
    )  # without the limit of a processor
    layout = Layout(
        plant=plant.plant,
        observers=tuple((names[o], cell.entry(o).observer) for o in options),
        width=width(cell, labels=options),
        ring=room,
        random_initial_state=drawn or choices.initial_spread > 0,
        continuous=measured.continuous,
        drifting=bool(true.parameter_drift and plant.plant.of_run),
        controller=loop_setup.controller(cell),
        scattered=bool(belief.initial_box),
        pending=loop_setup.pending(cell),
        consistency=choices.consistency,
        defined=cell.engine == "definition",
    )
    return Plan(
        cell=cell,
        layout=layout,
        problem=problem,
        certificates={o: d.certificate for o, d in designs.items()},
        bound=bound(unlimited, known, ask) if options else None,
        predicts_unknown_input={o: d.predicts_unknown_input for o, d in designs.items()},
        labels=tuple(options),
        reach=loop_setup.reach(cell, known.overtaking, n) if s.loop.controller else None,
    )


def _trigger(measured: Sampling) -> Trigger | tuple[()]:
    """Return which samples are sent; (): all of them."""
    if not measured.sensors_decide:
        return ()
    threshold = measured.send_threshold or (0.0,) * len(measured.delay)
    return Trigger(np.array(threshold), np.asarray(measured.try_once_discard))


def _inputs(cell: Cell, known: DesignContext, ask: memo.Once) -> NDArray[np.float64]:
    """Return the applied input of an open loop, [N+1, m]: 0 until the actuator's delay has passed.

    - If a controller computes the input: one row of NaN, as nothing may read it.
    - If the plant's output is C x + D u: zeros, as D is 0 in a closed loop.
    """
    s, m = cell.scenario, known.model.B.shape[1]
    if s.loop.controller:
        return np.full((1, m), 0.0 if plants.entry_of(s).plant is lti.PLANT else np.nan)
    n = cell.times.ticks
    late = min(to_ticks(s.loop.actuator_delay or 0.0, s), n + 1)

    def delayed() -> NDArray[np.float64]:
        u = inputs(s.loop.input, s.dt * np.arange(n + 1, dtype=float), m)
        return np.concatenate([np.zeros((late, u.shape[1])), u[: n + 1 - late]])

    u = ask("inputs", (s.loop.input, s.dt, n, m, late), delayed)
    if u.shape[1] != m:
        raise UserError(
            f"{s.name}: got the input '{s.loop.input}', which has {u.shape[1]} columns, expected one signal, or one for each "
            f"of the plant's {m} inputs with commas between; take one of {', '.join(SINGLE)}."
        )
    return u


def schedule_of(cell: Cell, run: tuple[int, int] | None = None) -> tuple[AnySchedule, int]:
    """Return the schedule of a grid point and its packets in flight; for one run (root seed, seed) if it is random."""
    s, clocks, n = cell.scenario, cell.times.clocks, cell.times.ticks
    error, channels = cell.times.error, len(s.sampling.delay)
    if s.sampling.continuous:
        return common_times.at_every_tick(n, channels), 1
    if cell.times.random and run is None:
        return random_times.times(clocks, n, channels, error), random_times.room(clocks, n, error)
    if len(clocks) == 1 and clocks[0].plain and not error:
        return common_times.plain_clock(clocks[0], n, channels)
    schedule = common_times.schedule(samples_of(cell, run), n, channels, error)
    return schedule, common_times.in_flight(schedule)


def samples_of(cell: Cell, run: tuple[int, int] | None = None) -> list[common_times.Sample]:
    """Return every sample of a grid point, also lost ones; for one run (root seed, seed) if sampling is random."""
    clocks, n, channels = cell.times.clocks, cell.times.ticks, len(cell.scenario.sampling.delay)
    random = run is not None and cell.times.random
    return random_times.draw_samples(clocks, n, channels, *run) if random and run else common_times.samples(clocks, n)


def alone(p: Plan, root_seed: int, seed: int) -> Plan:
    """Return the plan of a grid point for one run; if sampling is random, with the schedule of that run."""
    schedule, room = schedule_of(p.cell, (root_seed, seed))
    return p._replace(
        problem=p.problem._replace(schedule=schedule), layout=p.layout._replace(ring=max(room, p.layout.ring))
    )
