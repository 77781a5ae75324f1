"""Checks over whole runs: a perfect start stays perfect, delay 0 works, nothing is known before it arrives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.checking.fixtures import Case, Trial
from pcbench.checking.noise_free_runs import none, replay
from pcbench.checking.observer_functions import AGE, TICK, given
from pcbench.checking.targets import Skipped, require
from pcbench.protocols import Arrival
from pcbench.simulation.simulate_runs import Shift
from pcbench.simulation.types import present

ROUNDING = 1e-9  # of the largest state: a tick of slip is more than 1e-5
LINEAR = 1e-5  # what a linear model may be off where a run is near the operating point
WRONG = 0.07  # part by which a start is wrong where one is needed


def perfect_start(t: Trial) -> str:
    """True model, true start, no noise: no error, on every schedule."""
    if not t.knows_schedule:
        raise Skipped("it declares that it does not know the schedule")
    if t.cases[0].setting.model.E is not None:
        raise Skipped("an unknown input pushes this plant: no start stays perfect; name a --scenario without one")
    for case in t.cases:
        p = case.problem
        got = jax.tree.map(np.asarray, replay(t, p._replace(xhat0=p.x0), none(p)))
        n = len(p.x0)  # what is unknown beside the states may take its time
        e = np.abs(got.x[:, :n] - got.estimates[t.label][:, :n]).max(1) / np.abs(got.x[:, :n]).max()
        bad = np.flatnonzero(~(e <= (LINEAR if t.near else ROUNDING)))
        require(
            not bad.size,
            f"perfect start on {case.name}: got an error of {e[bad[0]] if bad.size else 0:.2g} of the largest state at tick "
            f"{bad[0] if bad.size else 0}, expected none (true model, true start, no noise); look for a tick of slip, or "
            "declare knows_schedule False.",
        )
    return f"no error on {_many(t)}" + (", near the operating point" if t.near else "")


def delay_0(t: Trial) -> str:
    """A sample may arrive at the tick it is taken: numbers stay finite, and u of that tick is not known to jump."""
    case = t.called("delay 0")
    if case is None:
        raise Skipped("its design refuses delay 0")
    got = _estimates(t, case)
    bad = np.flatnonzero(~np.isfinite(got).all(1))
    require(
        not bad.size,
        f"delay 0: got an estimate that is not finite at tick {bad[0] if bad.size else 0}, expected numbers when a sample of "
        "age 0 arrives; divide by no age.",
    )
    k = int(case.setting.period[0])
    require(
        _same_until(t, case, k, none(case.problem), inputs_from=k),
        f"delay 0: got an estimate of tick {k} that depends on the input of that same tick, expected u up to tick {k - 1}; in "
        "snapshot and jump ask past_u for an age of at least 1.",
    )
    return "a sample of age 0 is used, the input of its tick is not"


def no_peeking(t: Trial) -> str:
    """Estimates do not depend on what has not arrived: values, ages, notes, channels, inputs."""
    _not_fresh(t, t.cases[0])
    for case in t.cases:
        plan, every = case.problem.schedule, int(case.setting.period[0])
        for k in (every // 2, 3 * every + 1):
            arrived = plan.arrive[: k + 1].max(initial=-1), set(plan.arrive[: k + 1].ravel().tolist())
            many = len(plan.sense) + 1
            later = np.array([i not in arrived[1] for i in range(many)], float)
            shift = Shift(jnp.tile(jnp.asarray(later)[:, None], len(case.problem.noise_std)), jnp.asarray(later))
            require(
                _same_until(t, case, k, shift, inputs_from=max(k, 1), ages_from=k + 1),
                f"no peeking on {case.name}: got estimates up to tick {k} that change with what arrives later, or with later "
                "inputs, expected the same bits; use past_u with ages of 0 or more only, and of an arrival what is fresh.",
            )
    return f"what has not arrived changes no bit of an estimate, on {_many(t)}"


def after_the_jump(t: Trial) -> str:
    """An arrival shows in the estimate of its own tick, or as a rate of the flow from there on."""
    case = t.cases[0]
    k, number = _arrival(case)
    many, q = len(case.problem.schedule.sense) + 1, len(case.problem.noise_std)
    touched = jnp.asarray(np.arange(many) == number, float)
    shift = Shift(jnp.tile(touched[:, None], q), jnp.zeros(many))
    plain, other = (_estimates(t, case, s) for s in (none(case.problem), shift))
    moved = np.abs(other - plain).max(1)
    if not moved.any():
        return "no measurement changes its estimate"
    if not t.knows_schedule:
        raise Skipped("it declares that it does not know the schedule: when it corrects is its own")
    first = int(np.flatnonzero(moved)[0])
    rate = first == k + 1 and moved[first + 1] > RATE * moved[first]
    require(
        first == k or rate,
        f"after the jump: got an estimate that first shows an arrival of tick {k} at tick {first}, expected tick {k}; let "
        "estimate read the memory that jump returns.",
    )
    return "an arrival shows at its own tick" if first == k else "an arrival shows as a rate, from its own tick on"


RATE = 1.4  # a correction by a rate grows from tick to tick, by nearly 2 at first; a late one is there at once


def _arrival(case: Case) -> tuple[int, int]:
    """An arrival after a few others: its tick and its packet."""
    plan = case.problem.schedule
    ticks = np.flatnonzero((plan.arrive >= 0).any(1))
    k = int(ticks[min(2, len(ticks) - 1)])
    return k, int(plan.arrive[k].max())


def _estimates(t: Trial, case: Case, shift: Shift | None = None) -> np.ndarray:
    """The estimates of ticks 0 .. N from a start that is wrong, [N+1, n or n + s]."""
    p = case.problem
    wrong = p._replace(xhat0=p.x0 * (1 - WRONG) - WRONG)
    return np.asarray(replay(t, wrong, none(p) if shift is None else shift).estimates[t.label])


def _same_until(t: Trial, case: Case, k: int, shift: Shift, inputs_from: int, ages_from: int | None = None) -> bool:
    """Whether estimates of ticks 0 .. k have the same bits when data are shifted, and inputs and ages from a tick on."""
    p = case.problem
    u = np.array(p.inputs)
    u[inputs_from:] += 1.0
    plan = p.schedule
    if ages_from is not None:
        believed = np.array(plan.believed)
        believed[ages_from:] = np.maximum(believed[ages_from:] - 1, 0)
        plan = plan._replace(believed=believed)
    plain = _estimates(t, case)
    other = _estimates(t, case._replace(problem=p._replace(inputs=u, schedule=plan)), shift)
    return np.array_equal(plain[: k + 1], other[: k + 1], equal_nan=True)


def _not_fresh(t: Trial, case: Case) -> None:
    """Raise UserError where the value of a channel that did not arrive changes anything that is estimated."""
    o, q = t.observer, len(case.problem.noise_std)
    p = jax.tree.map(jnp.asarray, case.problem)
    g = given(t, case, p.gains[t.label])

    @jax.jit
    def after(gains: Any, memory: Any, channel: Any, value: Any) -> Any:
        y, mask = jnp.ones(q).at[channel].set(value), jnp.arange(q) != channel
        arrival = Arrival(y, mask, jnp.full(q, AGE), jnp.ones(q, int), g.snapshot, jnp.asarray(AGE))
        jumped = o.jump(gains, memory, present(p, jnp.asarray(TICK), False), arrival)
        return o.estimate(gains, jumped), o.estimate(gains, o.flow(gains, jumped, present(p, jnp.asarray(TICK), True)))

    for channel in range(q):
        results = [after(g.gains, g.memory, jnp.asarray(channel), jnp.asarray(value)) for value in (0.0, 77.0)]
        require(
            all(map(np.array_equal, *results)),
            f"no peeking: got an estimate that changes with the value of channel {channel + 1} where fresh is False, expected "
            "it to be ignored; take values by jnp.where(arrival.mask, ...).",
        )


def _many(t: Trial) -> str:
    refused = f" ({len(t.refused)} refused by its design)" if t.refused else ""
    return f"{len(t.cases)} schedules{refused}"
