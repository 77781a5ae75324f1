"""Runs for the checks of an observer: a scenario's plant, a true model, no noise, an input that never repeats.

The schedules are those that the observer declares to accept: the scenario's own, delay 0, a longer delay, and several
samples in transit. If it accepts them, also varying intervals and out-of-sequence samples. All have the same shape. An
observer may refuse a schedule with a UserError, but not all of them. An observer that is designed for the linear model
of a nonlinear plant runs so near the operating point that the plant is linear to rounding.
"""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree
from pydantic import BaseModel, ValidationError

from pcbench import planning
from pcbench.checking.jaxpr_checks import Functions, is_number
from pcbench.checking.targets import WHERE
from pcbench.errors import UserError, describe_exception, short, unknown
from pcbench.observers import ObserverSpec
from pcbench.plants import entry_of, nonlinear
from pcbench.protocols import Arrival, Gains, Now, Observer, Plant
from pcbench.scenarios import Loop, Sampling, Scenario, Truth
from pcbench.simulation.schedule import common_times
from pcbench.simulation.types import GridPointParams, present, truth
from pcbench.study import fits, times
from pcbench.study.grid import cell_of
from pcbench.study.plugins import registry
from pcbench.synthesis.certificate import Certificate, Design, DesignContext

NEAR = 1e-7  # distance from the operating point, relative to the initial spread, at which a plant is linear to rounding
SLOTS, SPAN = 3, 8  # largest number of arrivals at a tick; duration in sampling periods
VARYING = ("one clock", "any schedule")
TICK, AGE = 5, 2  # tick and age at which the functions are called; every schedule has them


class Candidate(NamedTuple):
    """An observer with its label and its options."""

    label: str
    entry: ObserverSpec
    options: BaseModel


def load(target: str, values: dict[str, Any] | None = None) -> Candidate:
    """Return the observer of MODULE:OBSERVER with the options `values`; raise UserError if there is none.

    OBSERVER is an attribute of the module. It is an `ObserverSpec`, or an `Observer` whose module contains its `design`
    and, if it has options, its `Options`.
    """
    entry, where = registry.load("observer", target, WHERE).entry, f"{WHERE} {short(target)}"
    by_field = {key.replace("-", "_"): value for key, value in (values or {}).items()}
    fields = getattr(entry.options, "model_fields", {})
    for key in by_field:
        if key not in fields:
            raise unknown(where, "option", key, fields)
    try:
        return Candidate(target.rpartition(":")[2], entry, entry.options(**by_field))
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(
            f"{where}: option {'.'.join(map(str, first['loc'])) or 'of Options'}: {first['msg']}; give it with "
            "--set OPTION=VALUE, or write a default."
        ) from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise UserError(f"{where}: its options cannot be made: {describe_exception(error)}; correct that.") from None


class Case(NamedTuple):
    """One schedule: what its designer needs to know, and the parameters of the run with the designed gains."""

    name: str
    context: DesignContext
    problem: GridPointParams


class Trial(NamedTuple):
    """An observer with its gains on every schedule that it accepts."""

    candidate: Candidate
    plant: Plant
    cases: tuple[Case, ...]
    refusals: tuple[str, ...]  # messages of its design for the other schedules
    near: bool = False  # whether the runs are near the operating point of a nonlinear plant

    @property
    def label(self) -> str:
        """Return the observer's label."""
        return self.candidate.label

    @property
    def observer(self) -> Observer:
        """Return the functions of the observer."""
        return self.candidate.entry.observer


def cases(scenario: Scenario, takes: str, near: bool = False) -> list[Case]:
    """Return the schedules of the checks, without gains; with `near` the runs stay near the operating point."""
    sampling, size = scenario.sampling, NEAR if near else 1.0
    x0 = tuple(NEAR * (std or 1.0) for std in scenario.belief.prior_std) if near else scenario.truth.x0
    period, n_channels = times.to_ticks(sampling.sampling_period[0], scenario), len(sampling.delay)
    seconds = [period * scenario.dt * delay for delay in (0, 1, 2.5)]
    is_usual = all(not isinstance(d, str) and times.to_ticks(d, scenario) <= 3 * period for d in sampling.delay)
    base = scenario._replace(
        truth=Truth(x0, unknown_input="zero" if scenario.truth.unknown_input else ""),
        loop=Loop(input="zero"),
        sampling=Sampling(
            sampling_period=(period * scenario.dt,) * n_channels,
            delay=sampling.delay if is_usual else (seconds[1],) * n_channels,
            noise_std=sampling.noise_std,
        ),
        duration=SPAN * period * scenario.dt,
    ).with_fields(xhat0=x0, assumed_delay_error=0.0, initial_box=(), steady_start=scenario.dt)
    scenarios = {"the scenario's own": base}
    for name, delay in zip(("delay 0", "one period late", "two and a half periods late"), seconds, strict=True):
        length = period * scenario.dt * 2 if delay == seconds[2] and period % 2 else delay
        scenarios[name] = base.with_fields(delay=(length,) * n_channels)
    if takes in VARYING:
        turn = tuple(max(part, 1) * scenario.dt for part in (period, period // 2, period + period // 3))
        scenarios["varying intervals"] = scenarios["one period late"].with_fields(sampling_pattern=turn)
    all_cases = [_case(name, s, None, size) for name, s in scenarios.items()]
    if takes in VARYING:
        all_cases.append(_case("samples out of sequence", scenarios["one period late"], period, size))
    roomiest = reduce(DesignContext.roomier, (c.context for c in all_cases))
    return [c._replace(context=c.context.roomier(roomiest)) for c in all_cases]


def _case(name: str, scenario: Scenario, spacing: int | None, size: float) -> Case:
    """Return one schedule, with inputs of a given size.

    With `spacing`, every third sample arrives 1.5 `spacing` ticks later.
    """
    cell = cell_of(scenario)
    context = planning.context_of(cell)
    draft = planning.draft(cell, {}, context)
    p, n, q = draft.problem, context.ticks, len(scenario.sampling.delay)
    if spacing is not None:
        samples = common_times.samples_of(times.clocks(scenario), n)
        delayed = [s._replace(arrives=s.arrives + (3 * spacing // 2 if s.number % 3 == 1 else 0)) for s in samples]
        context = context._replace(
            oosm_lag=common_times.max_oosm_lag(delayed),
            flight=context.flight + 2,
            latest=context.latest + 3 * spacing // 2,
        )
        p = p._replace(schedule=common_times.schedule(delayed, n, q))
    u = size * (np.random.default_rng(7).normal(size=p.inputs.shape) + 0.5)
    p = p._replace(schedule=common_times.pad_slots(p.schedule, SLOTS), inputs=u)
    arrays = jax.tree.map(jnp.asarray, p)
    signals = np.asarray(truth(draft.layout, arrays.params, present(arrays, jnp.asarray(0), True), arrays.x0))
    unknowns = signals[len(p.x0) :]
    true = unknowns if context.field is not None or context.successor is not None else context.unknown0
    return Case(name, context._replace(unknown0=tuple(map(float, true))), p)


def run_observer_design(candidate: Candidate, case: Case) -> Design:
    """Return the observer's design for one schedule; raise UserError if the result is not a Design."""
    where = f"design on {case.name}"
    try:
        design = candidate.entry.design(case.context, candidate.options)
    except UserError:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise Broken(
            f"{where}: got {describe_exception(error)}, expected Design(gains, Certificate); correct that line."
        ) from None
    if not isinstance(design, Design) or not isinstance(design.certificate, Certificate):
        raise Broken(
            f"{where}: got {type(design).__name__}, expected Design(gains, Certificate) of pcbench.synthesis.certificate; "
            "return that."
        )
    for leaf in jax.tree.leaves(design.gains):
        if not is_number(leaf):
            raise Broken(
                f"{where}: got a {type(leaf).__name__} among the gains, expected arrays of numbers only; keep words and "
                "functions out of gains."
            )
    return design


class Broken(UserError):
    """A design that raises an error other than UserError, or returns something other than a Design."""


def trial(candidate: Candidate, scenario: Scenario) -> Trial:
    """Design the observer for every schedule; raise UserError if it accepts none or its design is broken."""
    accepted: list[Case] = []
    refusals: dict[str, str] = {}
    near = nonlinear(scenario) and not candidate.entry.nonlinear
    if near:
        fits.works_on(candidate.label, candidate.entry, scenario, "design")
    for case in cases(scenario, candidate.entry.takes, near):
        try:
            design = run_observer_design(candidate, case)
        except Broken:
            raise
        except UserError as error:
            refusals[case.name] = str(error)
            continue
        accepted.append(case._replace(problem=case.problem._replace(gains={candidate.label: design.gains})))
    if not accepted:
        name, why = next(iter(refusals.items()))
        raise UserError(
            f"design: got a refusal of all {len(refusals)} schedules, on {name} '{why.rstrip('.')}', expected one that is "
            "taken; name a --scenario that the observer is made for."
        )
    return Trial(candidate, entry_of(scenario).plant, tuple(accepted), tuple(refusals.values()), near)


class ObserverArguments(NamedTuple):
    """Arguments of an observer's functions, of a plausible size."""

    gains: Gains
    memory: PyTree
    value: Array  # [q]
    snapshot: Array  # [r]
    xhat0: Array  # [n]
    inputs: Array  # [N+1, m]


def functions(t: Trial, case: Case) -> Functions:
    """Return every function of the observer, each as a function of `ObserverArguments`."""
    o, q = t.observer, case.problem.noise_std.shape[0]

    def now(g: ObserverArguments, decided: bool) -> Now:
        return now_of(case.problem, g.inputs, decided)

    def jump(g: ObserverArguments) -> PyTree:
        arrival = Arrival(g.value, jnp.ones(q, bool), jnp.full(q, AGE), jnp.ones(q, int), g.snapshot, jnp.asarray(AGE))
        return o.jump(g.gains, g.memory, now(g, False), arrival)

    return {
        "init": lambda g: o.init(g.gains, g.xhat0),
        "snapshot": lambda g: o.snapshot(g.gains, g.memory, now(g, False)),
        "jump": jump,
        "flow": lambda g: o.flow(g.gains, g.memory, now(g, True)),
        "estimate": lambda g: o.estimate(g.gains, g.memory),
    }


def make_observer_arguments(t: Trial, case: Case, gains: Gains | None = None) -> ObserverArguments:
    """Return the functions' arguments, with the gains of the case or others, and a memory from `init`."""
    o, p = t.observer, case.problem
    n, q = p.x0.shape[0], p.noise_std.shape[0]
    gains, u = jax.tree.map(jnp.asarray, p.gains[t.label] if gains is None else gains), jnp.asarray(p.inputs)
    xhat0 = jnp.asarray(p.x0) + jnp.arange(1.0, n + 1)

    def start(gains: Gains, xhat0: Array) -> tuple[PyTree, Array]:
        memory = o.init(gains, xhat0)
        return memory, jnp.asarray(o.snapshot(gains, memory, now_of(p, u, False)))

    memory, snapshot = jax.jit(start)(gains, xhat0)
    return ObserverArguments(gains, memory, jnp.arange(1.0, q + 1), snapshot, xhat0, u)


def now_of(p: GridPointParams, inputs: Array, decided: bool) -> Now:
    """Return the argument `now` of a tick, before or after its input is decided."""
    return present(p._replace(inputs=inputs, dt=jnp.asarray(p.dt)), jnp.asarray(TICK), decided)
