"""Checks that an observer follows the protocol.

A check runs only if the checks that it needs have passed. Without a design nothing else is checked, and without the
right shapes no runs.

In whole runs, the checks require that a true initial state keeps the error at 0, that delay 0 works, and that an
estimate does not depend on data that have not arrived. To test this, the values and snapshots of single packets are
changed, and so are ages and inputs. Two runs are then compared bit for bit.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from pcbench.checking import jaxpr_checks
from pcbench.checking.jaxpr_checks import WIDTH, is_same_program, perturb_lane, program
from pcbench.checking.noise_free_runs import errors, limit_duration, noise_free, plan_cell, record_run, relative_errors
from pcbench.checking.observer_fixtures import (
    AGE,
    TICK,
    Candidate,
    Case,
    Trial,
    functions,
    make_observer_arguments,
    run_observer_design,
    trial,
)
from pcbench.checking.study import LINEAR, ROUNDING, claims_it, require_none
from pcbench.checking.targets import Finding, SkipCheck, require, run_checks
from pcbench.errors import UserError
from pcbench.protocols import Arrival, Gains
from pcbench.scenarios import Scenario
from pcbench.simulation import trajectory
from pcbench.simulation.shape_checks import check as shapes_of
from pcbench.simulation.simulate_runs import Shift
from pcbench.simulation.trajectory import Recording
from pcbench.simulation.types import GridPointParams, Layout, present
from pcbench.study.grid import cell_of
from pcbench.study.plugins.user_code import Code, UserPlugin

# entries of constant arrays that are no gains, as of selections and Runge-Kutta steps
ALLOWED = (-1.0, 0.0, 0.5, 1.0, 2.0)
RATE = 1.4  # a correction by a rate grows from tick to tick, by nearly 2 at first; a late one is complete at once
WRONG = 0.07  # relative error of a wrong initial state


def shapes(t: Trial) -> str:
    """Check that every function of the protocol returns arrays of the right shapes."""
    for case in t.cases:
        shapes_of(t.label, t.observer, case.problem, continuous=t.observer.field is not None)
    return "init, snapshot, jump, flow and estimate return arrays of the right shapes"


def gains(t: Trial) -> str:
    """Check that gains are arrays, and that a second design fits the same program without changed constants."""
    case = t.cases[0]
    first = run_observer_design(t.candidate, case).gains
    programs = {name: program(f, make_observer_arguments(t, case, first)) for name, f in functions(t, case).items()}
    for name, p in programs.items():
        constants = [a for a in p.numbers if a.ndim and a.dtype.kind == "f" and not np.isin(a, ALLOWED).all()]
        require(
            not constants,
            f"gains: got an array of shape {list(np.shape(constants[0])) if constants else []} written into {name}, expected "
            "every number among the gains; return it from design and read it from gains.",
        )
    last_case = t.cases[-1]
    context = last_case.context._replace(noise_std=tuple(2 * s or 1.0 for s in case.context.noise_std))
    second = run_observer_design(t.candidate, last_case._replace(context=context)).gains
    require(
        _form(first) == _form(second),
        f"gains: got {_form(second)} from another delay and noise, expected the form {_form(first)} of the first design; keep "
        "structure, shapes and types, and every number in an array; otherwise each grid point compiles its own program.",
    )
    for name, f in functions(t, case).items():
        require(
            is_same_program(program(f, make_observer_arguments(t, case, second)), programs[name]),
            f"gains: got other numbers in the program of {name} after another design, expected the gains alone to change; use "
            "from gains what design finds, not from a global or a closure.",
        )
    return "all numbers are gains; a second design uses the same program"


def _form(gains: Gains) -> str:
    shapes = jax.tree.map(lambda a: f"{np.asarray(a).dtype}{list(np.shape(a))}", gains)
    return str(jax.tree.structure(gains)) + " of " + str(jax.tree.leaves(shapes))


def lanes(t: Trial) -> str:
    """Check that each run of a batch gives the results that it gives alone; runs are on the last axis."""
    first = make_observer_arguments(t, t.cases[0])
    rows = [(perturb_lane(first.memory, i), first.value * (1 + i)) for i in range(WIDTH)]
    return jaxpr_checks.lanes(functions(t, t.cases[0]), rows, lambda row: first._replace(memory=row[0], value=row[1]))


def no_shift(p: GridPointParams) -> Shift:
    """Return a shift that changes nothing, for N + 2 packets: at most one per tick, and a spare one."""
    count = p.schedule.sense.shape[0] + 1
    return Shift(jnp.zeros((count, p.noise_std.shape[0])), jnp.zeros(count))


def record(t: Trial, p: GridPointParams, shift: Shift) -> Recording:
    """Record a run of the observer with the parameters `p` and shifted packets; there is room for all packets at once."""
    problem = p._replace(noise_std=np.zeros_like(p.noise_std))
    layout = Layout(t.plant, ((t.label, t.observer),), 1, len(shift.snapshots), False)
    return trajectory.jit_record()(layout, problem, np.asarray(0), np.asarray(0), shift)


def perfect_start(t: Trial) -> str:
    """Check that the error stays 0 with a true model, a true initial state and no noise, on every schedule."""
    if not t.candidate.entry.knows_schedule:
        raise SkipCheck("it declares knows_schedule = False")
    if t.cases[0].context.model.E is not None:
        raise SkipCheck("this plant has an unknown input, so the error cannot stay 0; name a --scenario without one")
    for case in t.cases:
        p = case.problem
        got = jax.tree.map(np.asarray, record(t, p._replace(xhat0=p.x0), no_shift(p)))
        n = len(p.x0)  # estimates of unknown inputs and parameters may converge later
        e = np.abs(got.x[:, :n] - got.estimates[t.label][:, :n]).max(1) / np.abs(got.x[:, :n]).max()
        for k in np.flatnonzero(~(e <= (LINEAR if t.near else ROUNDING))):
            raise UserError(
                f"perfect start on {case.name}: got an error of {e[k]:.2g} of the largest state at tick {k}, expected none "
                "(true model, true start, no noise); look for an offset of one tick, or declare knows_schedule False."
            )
    return f"no error on {_describe_schedules(t)}" + (", near the operating point" if t.near else "")


def delay_0(t: Trial) -> str:
    """Check delay 0: numbers stay finite, and `jump` does not use the input of its own tick."""
    case = next((case for case in t.cases if case.name == "delay 0"), None)
    if case is None:
        raise SkipCheck("its design refuses delay 0")
    for tick in np.flatnonzero(~np.isfinite(_estimates(t, case)).all(1)):
        raise UserError(
            f"delay 0: got an estimate that is not finite at tick {tick}, expected numbers when a sample of age 0 arrives; "
            "do not divide by an age."
        )
    k = int(case.context.period[0])
    require(
        _same_until(t, case, k, no_shift(case.problem), inputs_from=k),
        f"delay 0: got an estimate of tick {k} that depends on the input of that same tick, expected u up to tick {k - 1}; in "
        "snapshot and jump ask past_u for an age of at least 1.",
    )
    return "a sample of age 0 is used, the input of its tick is not"


def no_peeking(t: Trial) -> str:
    """Check that estimates do not depend on data that have not arrived: values, ages, snapshots, channels, inputs."""
    _require_masked(t, t.cases[0])
    for case in t.cases:
        schedule, period = case.problem.schedule, int(case.context.period[0])
        for k in (period // 2, 3 * period + 1):
            in_transit = jnp.asarray(~np.isin(np.arange(len(schedule.sense) + 1), schedule.arrive[: k + 1]), float)
            shift = Shift(jnp.tile(in_transit[:, None], len(case.problem.noise_std)), in_transit)
            require(
                _same_until(t, case, k, shift, inputs_from=max(k, 1), ages_from=k + 1),
                f"no peeking on {case.name}: got estimates up to tick {k} that change with what arrives later, or with later "
                "inputs, expected the same bits; use past_u with ages of 0 or more only, and values only if mask is true.",
            )
    return f"no estimate depends on data that have not arrived, on {_describe_schedules(t)}"


def after_the_jump(t: Trial) -> str:
    """Check that an arrival changes the estimate of its own tick, or the rate of the flow from that tick on."""
    case = t.cases[0]
    schedule, q = case.problem.schedule, len(case.problem.noise_std)
    k = int(np.flatnonzero((schedule.arrive >= 0).any(1))[:3][-1])  # the tick of an arrival after a few others
    count = len(schedule.sense) + 1
    packet_mask = jnp.asarray(np.arange(count) == schedule.arrive[k].max(), float)
    shift = Shift(jnp.tile(packet_mask[:, None], q), jnp.zeros(count))
    unshifted, perturbed = (_estimates(t, case, s) for s in (no_shift(case.problem), shift))
    change = np.abs(perturbed - unshifted).max(1)
    if not change.any():
        return "no measurement changes its estimate"
    if not t.candidate.entry.knows_schedule:
        raise SkipCheck("it declares knows_schedule = False: it may correct at any tick")
    first = int(np.flatnonzero(change)[0])
    rate = first == k + 1 and change[first + 1] > RATE * change[first]
    require(
        first == k or rate,
        f"after the jump: got an estimate that first shows an arrival of tick {k} at tick {first}, expected tick {k}; let "
        "estimate read the memory that jump returns.",
    )
    return "an arrival shows at its own tick" if first == k else "an arrival shows as a rate, from its own tick on"


def _estimates(t: Trial, case: Case, shift: Shift | None = None) -> np.ndarray:
    """Return the estimates at ticks 0 .. N, from a wrong initial state, [N+1, n or n + s]."""
    p = case.problem
    wrong = p._replace(xhat0=p.x0 * (1 - WRONG) - WRONG)
    return np.asarray(record(t, wrong, no_shift(p) if shift is None else shift).estimates[t.label])


def _same_until(t: Trial, case: Case, k: int, shift: Shift, inputs_from: int, ages_from: int | None = None) -> bool:
    """Return whether the estimates of ticks 0 .. k keep their bits if packets, later inputs and later ages are changed."""
    p = case.problem
    u = np.array(p.inputs)
    u[inputs_from:] += 1.0
    schedule = p.schedule
    if ages_from is not None:
        timestamp = np.array(schedule.timestamp)
        timestamp[ages_from:] = np.maximum(timestamp[ages_from:] - 1, 0)
        schedule = schedule._replace(timestamp=timestamp)
    unshifted = _estimates(t, case)
    perturbed = _estimates(t, case._replace(problem=p._replace(inputs=u, schedule=schedule)), shift)
    return np.array_equal(unshifted[: k + 1], perturbed[: k + 1], equal_nan=True)


def _require_masked(t: Trial, case: Case) -> None:
    """Raise UserError if the value of a channel without an arrival changes an estimate."""
    o, q = t.observer, len(case.problem.noise_std)
    p = jax.tree.map(jnp.asarray, case.problem)
    g = make_observer_arguments(t, case)

    @jax.jit
    def estimates(gains: Gains, memory: PyTree, channel: Array, value: Array) -> tuple[Array, Array]:
        y, mask = jnp.ones(q).at[channel].set(value), jnp.arange(q) != channel
        arrival = Arrival(y, mask, jnp.full(q, AGE), jnp.ones(q, int), g.snapshot, jnp.asarray(AGE))
        new_memory = o.jump(gains, memory, present(p, jnp.asarray(TICK), False), arrival)
        next_memory = o.flow(gains, new_memory, present(p, jnp.asarray(TICK), True))
        return o.estimate(gains, new_memory), o.estimate(gains, next_memory)

    for channel in range(q):
        results = [estimates(g.gains, g.memory, jnp.asarray(channel), jnp.asarray(value)) for value in (0.0, 77.0)]
        require(
            all(map(np.array_equal, *results)),
            f"no peeking: got an estimate that changes with the value of channel {channel + 1} where arrival.mask is "
            "False, expected it to be ignored; select values by jnp.where(arrival.mask, ...).",
        )


def _describe_schedules(t: Trial) -> str:
    refusals = f" ({len(t.refusals)} refused by its design)" if t.refusals else ""
    return f"{len(t.cases)} schedules{refusals}"


def closed_loop(candidate: Candidate, scenario: Scenario) -> str:
    """Check a closed loop without noise from a true initial state.

    If the observer claims so, the error must be 0. Otherwise it must stay below the divergence threshold.
    """
    label, plugin = candidate.label, UserPlugin(candidate.entry, Code("", candidate.label, (), ""))
    cell = cell_of(scenario)._replace(options={label: candidate.options}, user_observers={label: plugin})
    (p,) = plan_cell(noise_free(limit_duration(cell)))
    out, where = record_run(p, noise=False), f"closed loop: got, in {scenario.name} under {scenario.loop.controller},"
    if claims_it(cell, label):
        require_none(relative_errors(p, out)[label], where, cell)
        return f"no error in {scenario.name} under {scenario.loop.controller}"
    e = errors(p, out)[label]
    bad = np.flatnonzero(~(e <= p.problem.bound[: e.shape[1]]).all(1))
    if bad.size:
        raise UserError(
            f"{where} an error beyond the scenario's divergence threshold at tick {bad[0]}, expected one that stays within "
            "it (true model, true start, no noise); give it other gains, or a --scenario whose loop is slower."
        )
    return f"its error in {scenario.name} under {scenario.loop.controller} stays below the divergence threshold"


CHECKS: dict[str, Callable[[Trial], str]] = {
    "shapes": shapes,
    "purity": lambda t: jaxpr_checks.purity(functions(t, t.cases[0]), make_observer_arguments(t, t.cases[0])),
    "gains": gains,
    "float64": lambda t: jaxpr_checks.float64(functions(t, t.cases[0]), make_observer_arguments(t, t.cases[0])),
    "many runs": lanes,
    "perfect start": perfect_start,
    "delay 0": delay_0,
    "no peeking": no_peeking,
    "after the jump": after_the_jump,
}
BASIC = ("shapes",)  # must pass before another check is run
WHOLE_RUNS = ("perfect start", "delay 0", "no peeking", "after the jump", "closed loop")  # checks that simulate runs
NEEDS = {"": BASIC, "shapes": (), "gains": (*BASIC, "purity"), **dict.fromkeys(WHOLE_RUNS, (*BASIC, "many runs"))}


def findings(candidate: Candidate, scenario: Scenario) -> list[Finding]:
    """Return the results of all checks of an observer on a scenario's plant."""

    def design() -> tuple[Trial, str]:
        t = trial(candidate, scenario)
        refusals = f"; refused {len(t.refusals)}: {t.refusals[0]}" if t.refusals else ""
        return t, f"gains on {len(t.cases)} schedules of {scenario.name}{refusals}"

    loop = {"closed loop": lambda t: closed_loop(candidate, scenario)} if scenario.loop.controller else {}
    return run_checks("design", design, CHECKS | loop, NEEDS)
