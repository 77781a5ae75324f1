"""From a study to the arrays of a simulation: gains, inputs, schedules and bounds, one draft per grid point.

`bound` computes the smallest RMSE that any causal estimator can have at a grid point.
"""

from collections.abc import Callable, Container, Iterable, Iterator
from functools import partial
from math import inf, isfinite

import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray
from pydantic import BaseModel

from pcbench import plants
from pcbench.dynamics import linear
from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.observers import base_of
from pcbench.observers.parts import assumed_noise
from pcbench.planning import loop_setup, memo, operation_counts, padding, processor
from pcbench.planning.design_context import context_of, prepare_params
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


def bound(cell: Cell, context: DesignContext, cache: memo.Cache = memo.no_cache) -> NDArray[np.float64] | None:
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
    context = context._replace(noise_std=s.sampling.noise_std)  # the true value, not the assumed one
    model_key = key_of((context.model, context.dt, context.noise_covariance, s.truth.process_std))
    key = model_key, key_of((context.ticks, context.noise_covariance, context.P0, cell.times.tail)), tuple(clocks)
    steps = cache("steps", model_key, riccati.no_steps)
    transitions = cache("transitions", (model_key, context.ticks), lambda: _over_ticks(context, s.truth.process_std))

    def compute_bound() -> NDArray[np.float64]:
        _, C, R = assumed_noise.decorrelate_outputs(context, None, context.model.C, context.scenario)
        samples = common_times.times_of_samples(clocks, context.ticks)
        tail = range(cell.times.tail, context.ticks)
        return np.sqrt(riccati.posterior_variance(*transitions, C, R, context.P0, samples, tail, steps))

    return cache("bound", key, compute_bound)


def _over_ticks(context: DesignContext, process_std: ProcessNoise) -> tuple[linear.Matrix, linear.Matrix]:
    """Return the transition and the noise of the true model over 2^b ticks."""
    transitions = linear.doublings(context.model, context.dt, linear.bits_for(context.ticks))
    noise = context._replace(process_std=process_std).process_noise
    return transitions, linear.noise_doublings(context.model, noise, context.dt, len(transitions))


def plan(study: Study) -> list[Plan]:
    """Return the plan of every grid point with all designs and arrays; raise UserError if a gain is not certified."""
    return padding.fit(list(drafts(cells_of(study), runs=lambda cell: study.seeds)))


def drafts(
    cells: list[Cell],
    keys: Container[tuple[str, int]] | None = None,
    cache: memo.Cache | None = None,
    runs: Callable[[Cell], int] | None = None,
    skip: int = 0,
    split_expensive: bool = False,
) -> Iterator[Plan]:
    """Yield a draft of every grid point except the first `skip`; in a closed loop one per observer, as each has its own plant.

    If `split_expensive`, each expensive observer also has its own draft. If processors have a limited speed, every observer
    does.

    Grid points whose key is not in `keys` (None: all are) are drafted without gains, to find the room that a program needs.
    `cache` is a cache that grid points share. `runs` returns the number of runs of a grid point, which limits the width.
    """
    cache = cache or memo.new_cache()
    largest: dict[str, DesignContext] = {}
    is_limited = any(isfinite(cell.scenario.sampling.processor_speed) for cell in cells)
    groups_by_cell = [
        _groups(cell, cache, is_limited, split_expensive, keys is None or cell.key in keys) for cell in cells
    ]
    contexts = [{tuple(c.times.clocks): context_of(c, cache) for c, _ in groups} for groups in groups_by_cell]
    for cell, by_clocks in zip(cells, contexts, strict=True):
        for context in by_clocks.values() if not cell.times.random else ():
            largest[cell.scenario.plant] = context.roomier(largest.get(cell.scenario.plant, context))
    for groups, by_clocks in zip(groups_by_cell[skip:], contexts[skip:], strict=True):
        for cell, options in groups:
            context = by_clocks[tuple(cell.times.clocks)]
            if cell.times.random:  # room for all would cost more than another program
                context = context._replace(spare=power_of_2(context.oosm_lag))
            else:
                context = context.roomier(largest[cell.scenario.plant])
            p = draft(cell, options, context, cache)
            yield p._replace(layout=p.layout._replace(width=width(cell, runs(cell), options))) if runs else p


Group = tuple[Cell, dict[str, BaseModel]]


def _groups(cell: Cell, cache: memo.Cache, is_limited: bool, split_expensive: bool, has_options: bool) -> list[Group]:
    """Return groups of observers that share a program: the grid point with the samples they can process, and their options.

    With a processor of limited speed (`is_limited`) no program is shared. If not `has_options`, the options are empty.
    """
    is_separate = is_limited or bool(cell.scenario.loop.controller)
    # observers with their own program
    separate = [o for o in cell.options if is_separate or (split_expensive and cell.entry(o).expensive)]
    common = {o: values for o, values in cell.options.items() if o not in separate}
    groups = [(cell, common), *((with_computing_time(cell, o, cache), {o: cell.options[o]}) for o in separate)]
    if not has_options:
        return [(c, {}) for c, _ in (groups if is_limited else groups[:1])]
    return [group for group in groups if group[1]] or [(cell, {})]


def with_computing_time(cell: Cell, label: str, cache: memo.Cache = memo.no_cache) -> Cell:
    """Return a grid point with the samples that an observer's processor has time for (`processor`)."""
    s, speed, times = cell.scenario, cell.scenario.sampling.processor_speed, times_of(cell.scenario)
    if not isfinite(speed):
        return cell
    free = cell.with_fields(processor_speed=inf)

    def count() -> Callable[[int, int], operation_counts.Cost]:
        p = draft(free, {label: cell.options[label]})
        return operation_counts.counter(p, *p.layout.observers[0])

    key = identity(free, 0), label, options_digest(cell.options[label], cell.user_observers.get(label))
    load = processor.load_of(cache("counters", key, count), times.clocks[0], times.ticks, speed, s.dt)
    return cell._replace(times=processor.with_load(times, load))


def width(cell: Cell, runs: int | None = None, labels: Iterable[str] = ()) -> int:
    """Return the runs per call, fewer if a light grid point has few `runs`; this does not change any bit of the results.

    Observers whose bits depend on the width have a fixed one (`ObserverSpec.lanes`). The definition has one width for all
    calls of a program with the observers `labels`.
    """
    if cell.engine == "definition":
        return (
            runner.EXPENSIVE_WIDTH if any(cell.entry(label).expensive for label in labels) else runner.DEFINITION_WIDTH
        )
    if widths := [lanes for label in cell.options if (lanes := cell.entry(label).lanes)]:
        return min(widths)
    max_width = runner.HEAVY_WIDTH if plants.entry_of(cell.scenario).heavy else runner.WIDTH
    if runs is None:
        return max_width
    return next((lanes for lanes in runner.NARROW_WIDTHS if runs <= lanes < max_width), max_width)


def draft(
    cell: Cell, options: dict[str, BaseModel], context: DesignContext | None = None, cache: memo.Cache = memo.no_cache
) -> Plan:
    """Return the plan of one grid point for the observers in `options`; `padding.fit` gives it a common shape later."""
    s, context = cell.scenario, context or context_of(cell, cache)
    truth, belief, choices, sampling = s.truth, s.belief, cell.choices, s.sampling
    plant, n = plants.entry_of(s), cell.times.ticks
    designs = {
        o: cache("designs", (cell.key, o), partial(memo.run_design, o, cell.entry(o), context, values))
        for o, values in options.items()
    }
    names = {o: (base_of(o) or o) if s.loop.controller else o for o in options}
    has_box, step = choices.random_initial_state and bool(belief.initial_box), sampling.quantization_step
    from_prior = choices.random_initial_state and not has_box
    key = tuple(cell.times.clocks), n, cell.times.error, sampling.continuous, len(sampling.delay)
    schedule, room = cache("schedule", key, lambda: schedule_of(cell))
    problem = GridPointParams(
        params=prepare_params(plant, _plant_numbers(cell), s.dt, n, cache),
        gains={names[o]: d.gains for o, d in designs.items()},
        schedule=schedule,
        inputs=_inputs(cell, context, cache),
        dt=np.asarray(s.dt),
        x0=np.array(belief.xhat0 if from_prior else truth.x0),
        xhat0=np.array(truth.x0 if has_box else belief.xhat0),
        spread0=np.diag(belief.prior_std if from_prior else choices.initial_spread * np.abs(truth.x0)),
        noise_std=np.array(sampling.noise_std),
        band=np.array(s.scoring.settle_band),
        bound=np.broadcast_to(np.asarray(s.scoring.divergence_threshold, float), len(s.scoring.settle_band)),
        windows=np.array([[0, cell.times.tail], [cell.times.tail, n - 1], [n - 1, n]]),
        process_std=np.array(truth.process_std),
        jumps=np.array([tick for tick in jumps(truth.unknown_input, s.dt, n - 1) if tick >= cell.times.tail], int),
        scatter=np.array(belief.initial_box) * has_box,
        network=loop_setup.network(cell),
        weights=loop_setup.weights(cell),
        outliers=_outliers(sampling),
        rounding=Rounding(np.array(step), np.asarray(sampling.dither)) if any(step) else (),
        trigger=_trigger(sampling),
        student_t_dof=np.asarray(dof) if np.isfinite(dof := sampling.student_t_dof) else (),
        noise_root=np.linalg.cholesky(rho) if (rho := sampling.noise_correlation) else np.zeros((0, 0)),
    )
    # without the limit of a processor
    unlimited_cell = cell._replace(times=times_of(s)) if isfinite(sampling.processor_speed) else cell
    layout = Layout(
        plant=plant.plant,
        observers=tuple((names[o], cell.entry(o).observer) for o in options),
        width=width(cell, labels=options),
        ring=room,
        random_initial_state=from_prior or choices.initial_spread > 0,
        continuous=sampling.continuous,
        drifting=bool(truth.parameter_drift and plant.plant.of_run),
        controller=loop_setup.controller(cell),
        scattered=bool(belief.initial_box),
        pending=loop_setup.max_pending(cell),
        consistency=choices.consistency,
        by_definition=cell.engine == "definition",
    )
    return Plan(
        cell=cell,
        layout=layout,
        problem=problem,
        certificates={o: d.certificate for o, d in designs.items()},
        bound=bound(unlimited_cell, context, cache) if options else None,
        predicts_unknown_input={o: d.predicts_unknown_input for o, d in designs.items()},
        labels=tuple(options),
        reach=loop_setup.reach(cell, context.oosm_lag, n) if s.loop.controller else None,
    )


def _plant_numbers(cell: Cell) -> PyTree:
    """Return the plant's true numbers: its own with the changes of the scenario and the grid point."""
    s, truth = cell.scenario, cell.scenario.truth
    names = plants.entry_of(s).numbers._fields
    numbers: TomlTable = {"drift": truth.parameter_drift} if "drift" in names else {}
    numbers |= cell.parameters
    if "sensor_delay" in names:  # delay of the samples [s], or its mean if it varies
        clock = cell.times.clocks[0]
        numbers["sensor_delay"] = (
            float((clock.period if clock.delay is None else clock.delay) + clock.mean_extra_delay) * s.dt
        )
    numbers |= {"unknown_input": truth.unknown_input} if truth.unknown_input else {}
    return plants.replace_numbers(plants.numbers_of(s), numbers)


def _outliers(sampling: Sampling) -> Outliers | tuple[()]:
    """Return probability and scale of outliers, one of each or one per channel; (): none."""
    numbers = sampling.outlier_probability, sampling.outlier_scale
    if not sampling.outlier_probability:
        return ()
    n_channels = len(sampling.delay) if any(isinstance(a, tuple) for a in numbers) else 0
    return Outliers(*(np.asarray(per_channel(a, n_channels) if n_channels else a) for a in numbers))


def _trigger(sampling: Sampling) -> Trigger | tuple[()]:
    """Return which samples are sent; (): all of them."""
    if not sampling.sensors_decide:
        return ()
    threshold = sampling.send_threshold or (0.0,) * len(sampling.delay)
    return Trigger(np.array(threshold), np.asarray(sampling.try_once_discard))


def _inputs(cell: Cell, context: DesignContext, cache: memo.Cache) -> NDArray[np.float64]:
    """Return the applied input of an open loop, [N+1, m]: 0 until the actuator's delay has passed.

    - If a controller computes the input: one row of NaN, as nothing may read it.
    - If the plant's output is C x + D u: zeros, as D is 0 in a closed loop.
    """
    s, m = cell.scenario, context.model.B.shape[1]
    if s.loop.controller:
        return np.full((1, m), 0.0 if plants.entry_of(s).plant is lti.PLANT else np.nan)
    n = cell.times.ticks
    delay = min(to_ticks(s.loop.actuator_delay or 0.0, s), n + 1)

    def delayed_input() -> NDArray[np.float64]:
        u = inputs(s.loop.input, s.dt * np.arange(n + 1, dtype=float), m)
        return np.concatenate([np.zeros((delay, u.shape[1])), u[: n + 1 - delay]])

    u = cache("inputs", (s.loop.input, s.dt, n, m, delay), delayed_input)
    if u.shape[1] != m:
        raise UserError(
            f"{s.name}: got the input '{s.loop.input}', which has {u.shape[1]} columns, expected one signal, or one for each "
            f"of the plant's {m} inputs with commas between; use one of {', '.join(SINGLE)}."
        )
    return u


def schedule_of(cell: Cell, run: tuple[int, int] | None = None) -> tuple[AnySchedule, int]:
    """Return the schedule of a grid point and its packets in flight; for one run (root seed, seed) if it is random."""
    s, clocks, n = cell.scenario, cell.times.clocks, cell.times.ticks
    error, channels = cell.times.error, len(s.sampling.delay)
    if s.sampling.continuous:
        return common_times.every_tick_schedule(n, channels), 1
    if cell.times.random and run is None:
        return random_times.clock_params(clocks, n, channels, error), random_times.room(clocks, n, error)
    if len(clocks) == 1 and clocks[0].plain and not error:
        return common_times.plain_clock(clocks[0], n, channels)
    schedule = common_times.schedule(samples_of(cell, run), n, channels, error)
    return schedule, common_times.in_flight(schedule)


def samples_of(cell: Cell, run: tuple[int, int] | None = None) -> list[common_times.Sample]:
    """Return every sample of a grid point, also lost ones; for one run (root seed, seed) if sampling is random."""
    clocks, n, channels = cell.times.clocks, cell.times.ticks, len(cell.scenario.sampling.delay)
    if run is not None and cell.times.random:
        return random_times.draw_samples(clocks, n, channels, *run)
    return common_times.samples_of(clocks, n)


def alone(p: Plan, root_seed: int, seed: int) -> Plan:
    """Return the plan of a grid point for one run; if sampling is random, with the schedule of that run."""
    schedule, room = schedule_of(p.cell, (root_seed, seed))
    return p._replace(
        problem=p.problem._replace(schedule=schedule), layout=p.layout._replace(ring=max(room, p.layout.ring))
    )
