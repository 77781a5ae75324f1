"""Checks that a plant follows the protocol. `pcbench.make_plant` has checked the basic conditions before.

The checks use points around the operating point. With a scenario, they use its tick, its duration and its initial
standard deviation. Without one, they use a tick of 1 ms (or that of the plant's `step`), 10 s, and a tenth of each
state at the operating point, or of 1 where the state is 0.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree
from numpy.typing import ArrayLike

from pcbench.checking import jaxpr_checks
from pcbench.checking.jaxpr_checks import WIDTH, Functions
from pcbench.checking.noise_free_runs import noise_free, plan_cell, record_run, relative_errors
from pcbench.checking.observer_fixtures import NEAR
from pcbench.checking.study import LINEAR, ROUNDING
from pcbench.checking.targets import CheckNote, Finding, SkipCheck, run_checks
from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Model, discretize_zoh
from pcbench.dynamics.observability import decays, format_mode, unobservable
from pcbench.errors import UserError, brief_repr, describe_exception
from pcbench.observers import entry_of as observer_of
from pcbench.plants import PlantSpec, entry_of, estimated_of, numbers_of, parameters_of, states_of
from pcbench.plants.nonlinear import REST
from pcbench.protocols import Now
from pcbench.scenarios import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.study import times
from pcbench.study.grid import cell_of

SHARE = 0.1  # distance of the points from the operating point, relative to the state
EVERY, POINTS, TICK = 20, 8, 5  # ticks between samples; points; the tick at which functions are called
STEP, CLOSE, KINK = 1e-5, 1e-6, 1e-2  # of the spread; of the slopes; of those from either side
EXACT = 1e-3  # part of a state that the ticks of a horizon may be off together


class PlantArguments(NamedTuple):
    """The arguments of a plant's functions."""

    params: PyTree
    x: Array  # [n]
    u: Array  # [m]


class Trial(NamedTuple):
    """A plant in a scenario, with its parameters: n states, m inputs."""

    label: str
    scenario: Scenario
    params: PyTree
    model: Model
    spread: np.ndarray  # [n] of the state around the operating point
    reach: np.ndarray  # [m] of the input

    @property
    def entry(self) -> PlantSpec:
        """Return the plant's specification."""
        return entry_of(self.scenario)

    @property
    def states(self) -> list[str]:
        """Return the names of the plant's states."""
        return [name for name, _ in states_of(self.scenario)]

    @property
    def axes(self) -> list[str]:
        """Return the names of the parameters that a study can vary."""
        return parameters_of(self.entry)


def trial(label: str, scenario: Scenario) -> tuple[Trial, str]:
    """Return a plant's trial and a text of its sizes; raise UserError if its parameters cannot be prepared."""
    entry, numbers = entry_of(scenario), numbers_of(scenario)
    params = jaxpr_checks.arrays(entry.prepare(numbers, scenario.dt, 2 * TICK))
    model, n = entry.nominal(numbers), len(states_of(scenario))
    (m, q) = (np.shape(model.B)[-1], len(model.C))
    for name, matrix, shape in (("A", model.A, (n, n)), ("B", model.B, (n, m)), ("C", model.C, (q, n))):
        if np.shape(matrix) != shape:
            raise UserError(
                f"numbers: got {name} of shape {list(np.shape(matrix))} in the linear model of {n} states, expected "
                f"{list(shape)}; give each state a name and a row."
            )
    _, u0 = _point(entry, n, m)
    spread = np.array([std or SHARE for std in scenario.belief.prior_std])
    t = Trial(label, scenario, params, model, spread, SHARE * np.where(u0, abs(u0), 1.0))
    axes_text = f"; axes: {', '.join(f'plant.{name}' for name in t.axes)}" if t.axes else ""
    return t, f"{n} states, {m} inputs, {q} outputs{axes_text}"


def plant_scenario(label: str, entry: PlantSpec, fields: dict[str, Any]) -> Scenario:
    """Return a scenario of the plant without observers, with other `fields`."""
    model, n = entry.nominal(entry.numbers), len(entry.signals)
    q, m, dt = len(model.C), np.shape(model.B)[-1], entry.tick or 1e-3
    x0, _ = _point(entry, n, m)
    start = tuple(map(float, SHARE * np.where(x0, abs(x0), 1.0)))
    unknowns = (1.0,) * len(entry.unknowns)
    return Scenario(
        name=label,
        summary="a plant alone",
        source="none",
        plant=label,
        observers=(),
        truth=Truth(start),
        loop=Loop(input="zero"),
        sampling=Sampling((EVERY * dt,) * q, (EVERY * dt,) * q, (0.0,) * q),
        belief=Belief(start, start, unknown_std=unknowns),
        scoring=Scoring((*start, *unknowns, *(1.0,) * len(entry.errors)), np.inf, steady_start=dt),
        dt=dt,
    ).with_fields(**fields)


def _point(entry: PlantSpec, n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the operating point of the plant, x0 [n] and u0 [m]; zeros if it has none."""
    x0, u0 = entry.operating_point or ((0.0,) * n, (0.0,) * m)
    return np.array(x0), np.array(u0)


def now_of(t: Trial, u: Array) -> Now:
    """Return the argument `now` with a constant input u."""
    dt = jnp.asarray(t.scenario.dt)
    return Now(TICK * dt, jnp.asarray(TICK), dt, u, lambda age: u)


def functions(t: Trial) -> Functions:
    """Return the plant's functions, each as a function of `PlantArguments`."""
    plant = t.entry.plant
    by_name = {"step": plant.step, "output": plant.output, "field": plant.field, "unknown": plant.unknown}

    def of(f: Callable[..., Array]) -> Callable[[PlantArguments], Array]:
        return lambda g: f(g.params, now_of(t, g.u), g.x)

    return {name: of(f) for name, f in by_name.items() if f is not None}


def motion(t: Trial) -> str:
    """Return the name of the function that moves the state: `field`, or `step` if the plant has no field."""
    return "step" if t.entry.plant.field is None or t.model.discrete else "field"


def points(t: Trial) -> list[PlantArguments]:
    """Return the operating point and points around it."""
    r = np.random.default_rng(7).uniform(-1, 1, (POINTS, len(t.spread) + len(t.reach)))
    rows = np.vstack([np.zeros(r.shape[1]), r]) * np.concatenate([t.spread, t.reach])
    n = len(t.spread)
    return [PlantArguments(t.params, jnp.asarray(row[:n]), jnp.asarray(row[n:])) for row in rows]


def point_text(t: Trial, g: PlantArguments) -> str:
    """Return a text of a point: its states and its input."""
    x = ", ".join(f"{name} {v:.3g}" for name, v in zip(t.states, np.asarray(g.x), strict=True))
    return f"{x} and u = {brief_repr(np.asarray(g.u).round(4).tolist())} from the operating point"


def result_names(t: Trial, name: str) -> list[str]:
    """Return the names of the entries of a function's result."""
    if name == "output":
        return [f"output {i + 1}" for i in range(len(t.model.C))]
    return [signal for signal, _ in estimated_of(t.scenario)][len(t.states) :] if name == "unknown" else t.states


def shapes(t: Trial) -> str:
    """Check that every function returns one number per state, output or unknown."""
    for name, f in functions(t).items():
        expected = (len(result_names(t, name)),)
        try:
            value = jax.eval_shape(lambda g, f=f: jnp.asarray(f(g)), points(t)[0])
        except Exception as error:
            raise UserError(
                f"shapes: {name} cannot be traced ({describe_exception(error)}), expected pure jax.numpy code for one run, "
                "with jnp.where instead of if; fix that line."
            ) from None
        if value.shape != expected:
            raise UserError(
                f"shapes: got an array of shape {list(value.shape)} from {name}, expected {list(expected)}, a number for each "
                f"of {', '.join(result_names(t, name))}; return all of them."
            )
    return f"{', '.join(functions(t))} return arrays of the right shapes"


def finite(t: Trial) -> str:
    """Check that all results are finite at the operating point and around it."""
    for name, function in functions(t).items():
        f = jax.jit(function)
        for g in points(t):
            value = np.asarray(f(g))
            for i in np.flatnonzero(~np.isfinite(value)):
                raise UserError(
                    f"finite: got {value[i]} for {result_names(t, name)[i]} in {name} at {point_text(t, g)}, expected a "
                    "number; prevent the invalid root or division there, or name a --scenario with a smaller prior_std."
                )
    return f"finite at the operating point and at {len(points(t)) - 1} points around it"


def slopes(t: Trial) -> str:
    """Check the derivatives of jax and of the linear model against central and one-sided finite differences."""
    # whether the linear model is the slope at the operating point
    is_slope = t.model.nonlinearity is None and (t.entry.model is None or t.entry.residual is not None)
    A, B = t.model.A, t.model.B
    if motion(t) == "step" and not t.model.discrete:
        A, B = discretize_zoh(A, B, t.scenario.dt)
    for name, model in ((motion(t), (A, B)), ("output", (t.model.C, t.model.feedthrough))):
        function = functions(t)[name]
        f, jacobian = jax.jit(function), jax.jit(jax.jacfwd(function))
        for i, g in enumerate(points(t)[: 1 + WIDTH]):
            of_jax = jacobian(g)
            slopes_x, slopes_u = model if not i and is_slope else (of_jax.x, of_jax.u)
            source = "the linear model" if not i and is_slope else "jax"
            _compare(t, name, f, g, "x", t.spread, np.asarray(slopes_x) * t.spread, source)
            _compare(t, name, f, g, "u", t.reach, np.asarray(slopes_u) * t.reach, source)
    return "jax and the linear model agree with finite differences"


def _compare(
    t: Trial,
    function: str,
    f: Callable[[PlantArguments], Array],
    g: PlantArguments,
    name: str,
    size: np.ndarray,
    expected: np.ndarray,
    source: str,
) -> None:
    """Raise UserError if derivatives, times the spread of the state, differ from finite differences."""
    value, names = np.asarray(f(g)), t.states if name == "x" else [f"u{i + 1}" for i in range(len(size))]

    def value_near(j: int, sign: int) -> np.ndarray:
        shifted = getattr(g, name).at[j].add(sign * STEP * size[j])
        return np.asarray(f(g._replace(**{name: shifted})))

    columns = range(len(size))
    up, down = ((np.stack([value_near(j, s) for j in columns], 1) - value[:, None]) * s / STEP for s in (1, -1))
    scale = np.abs(expected).max() + np.abs(value)[:, None] + np.abs(up)
    for difference, tol in (((up + down) / 2, CLOSE), (up, KINK), (down, KINK)):
        bad = np.argwhere(~(np.abs(difference - expected) <= tol * scale + 1e-300))
        if bad.size:
            i, j = bad[0]
            raise UserError(
                f"slopes: got {expected[i, j] / size[j]:.6g} from {source} and {difference[i, j] / size[j]:.6g} from "
                f"differences for the slope of {result_names(t, function)[i]} in {function} by {names[j]}, at "
                f"{point_text(t, g)}, expected the same; smooth the kink there, or leave out what hides a slope "
                "(stop_gradient, NumPy, rounding)."
            )


def axes(t: Trial) -> str:
    """Check that each parameter that a study can vary has an effect."""
    if not t.axes:
        raise SkipCheck("it has no parameters that a study can vary")
    numbers, ineffective = numbers_of(t.scenario), []
    fs = [jax.jit(f) for name, f in functions(t).items() if name != "unknown"]
    for name in t.axes:
        value = getattr(numbers, name)
        perturbed = t.entry.prepare(numbers._replace(**{name: 1.01 * value or 0.01}), t.scenario.dt, 10)
        params = jax.tree.map(jnp.asarray, perturbed)
        if all(np.array_equal(f(g), f(g._replace(params=params))) for f in fs for g in points(t)):
            ineffective.append(f"plant.{name}")
    if ineffective:
        raise CheckNote(
            f"around the operating point {', '.join(ineffective)} changes nothing: a study that varies it gets equal results"
        )
    return "each of its parameters changes the plant"


def rest(t: Trial) -> str:
    """Check that the operating point is an equilibrium."""
    rate = np.asarray(functions(t)[motion(t)](points(t)[0]))
    if t.entry.residual is not None:
        rate = t.entry.residual(numbers_of(t.scenario))
    bad = np.flatnonzero(np.abs(rate) > REST * (1 + np.abs(t.model.A).max()))
    if bad.size:
        rates = ", ".join(f"{t.states[i]} by {rate[i]:.4g}" for i in bad)
        raise CheckNote(
            f"no equilibrium: {rates} a {'tick' if motion(t) == 'step' else 'second'} at the operating point: observers that "
            "need a linear model refuse the plant there, ekf does not"
        )
    return "the operating point is an equilibrium"


def tick(t: Trial) -> str:
    """Check that one tick is as accurate as two of half its length."""
    if motion(t) == "step":
        raise SkipCheck("it is defined by its step: a tick has no integration error")
    dt, ticks = t.scenario.dt, times.to_ticks(t.scenario.duration, t.scenario)
    step, advance = jax.jit(functions(t)["step"]), stepping(t)
    difference = max(_relative_difference(t, g, step(g), advance(advance(g, dt / 2), dt / 2).x) for g in points(t))
    if not difference * ticks <= EXACT:
        shorter = next((h for h in finer(dt) if integration_error(t, advance, h) <= EXACT), None)
        advice = (
            f"write dt = {shorter:g}, or less"
            if shorter
            else "check that step agrees with field, or leave out dynamics that are so fast"
        )
        raise UserError(
            f"tick: got a tick of {dt:g} s that is off by {difference:.2g} of a state, {ticks} times in "
            f"{t.scenario.duration:g} s, expected {EXACT:g} at most in all; {advice}."
        )
    return f"a tick of {dt:g} s is off by {difference:.2g} of a state, {difference * ticks:.2g} in {t.scenario.duration:g} s"


def stepping(t: Trial) -> Callable[[PlantArguments, float], PlantArguments]:
    """Return a function that moves a point by one Runge-Kutta step of the field, of a given length [s]."""
    field = functions(t)["field"]

    @jax.jit
    def step(g: PlantArguments, h: Array) -> PlantArguments:
        start = now_of(t, g.u).t
        return g._replace(x=rk4(lambda s, x: field(g._replace(x=x)), start, g.x, h))

    return lambda g, h: step(g, jnp.asarray(h))


def _relative_difference(t: Trial, g: PlantArguments, one: ArrayLike, two: ArrayLike) -> float:
    """Return the difference of two results of a tick, divided by the state's spread; inf if one of them is not finite."""
    difference = np.abs(np.asarray(one) - np.asarray(two)) / np.maximum(t.spread, np.abs(np.asarray(g.x)))
    return float(difference.max()) if np.isfinite(difference).all() else np.inf


def integration_error(t: Trial, advance: Callable[[PlantArguments, float], PlantArguments], dt: float) -> float:
    """Return the summed error of all ticks of the duration, each a Runge-Kutta step of dt."""
    errors = (_relative_difference(t, g, advance(g, dt).x, advance(advance(g, dt / 2), dt / 2).x) for g in points(t))
    return max(errors) * t.scenario.duration / dt


def finer(dt: float) -> list[float]:
    """Return the ticks shorter than dt with first digit 1, 2 or 5, down to a millionth of it."""
    top = int(np.floor(np.log10(dt))) + 1
    return [h for p in range(7) for d in (5, 2, 1) if (h := float(f"{d}e{top - 1 - p}")) < dt * (1 - 1e-9)]


def check_observability(t: Trial) -> str:
    """Check that every mode of the linear model is visible in an output."""
    hidden = unobservable(t.model.A, t.model.C)
    persistent = [format_mode(mode) for mode in hidden if not decays(mode, t.model.discrete)]
    if persistent:
        raise CheckNote(
            f"no output shows the mode {' and '.join(persistent)}, which does not decay: no observer can estimate the state; "
            "measure another output"
        )
    if hidden:
        raise CheckNote(
            f"no output shows the mode {' and '.join(map(format_mode, hidden))}, which decays: observers that place every pole "
            "refuse the plant, kf and ekf do not"
        )
    return "every mode is observable"


def perfect_start(t: Trial) -> str:
    """Check that observers with the true model have no error, from a true initial state without noise."""
    if t.model.nonlinearity is not None:
        raise SkipCheck("its unknown input has a known part, which the linear model leaves out")
    is_nonlinear = t.entry.model is not None or t.entry.successor is not None
    at_rest = t.entry.residual is not None and not t.entry.residual(numbers_of(t.scenario)).any()
    name, size = ("ekf", 1.0) if is_nonlinear and not at_rest else ("model-only", NEAR if is_nonlinear else 1.0)
    q, period = len(t.model.C), EVERY * t.scenario.dt
    base = t.scenario._replace(
        loop=Loop(input="zero"), sampling=Sampling((period,) * q, (period,) * q, (1e-3,) * q), duration=4 * period
    )
    s = base.with_fields(x0=tuple(map(float, size * t.spread)), steady_start=t.scenario.dt)
    cell = cell_of(s)._replace(options={name: observer_of(name).options()})
    (p,) = plan_cell(noise_free(cell))
    u = size * t.reach * np.random.default_rng(7).normal(size=p.problem.inputs.shape)
    e = relative_errors(p, record_run(p, noise=False, inputs=u))[name]
    tol = LINEAR if size == NEAR else ROUNDING
    for k, i in np.argwhere(~(e <= tol)):
        raise UserError(
            f"perfect start: got an error of {e[k, i]:.2g} of the largest state in {t.states[i]} at tick {k}, where {name} "
            "has the true plant and start, expected none; let step be what field or the linear model gives, under now.u."
        )
    return f"{name} has no error from the true start" + (", near the operating point" if size == NEAR else "")


CHECKS: dict[str, Callable[[Trial], str]] = {
    "shapes": shapes,
    "purity": lambda t: jaxpr_checks.purity(functions(t), points(t)[1]),
    "float64": lambda t: jaxpr_checks.float64(functions(t), points(t)[1]),
    "finite": finite,
    "many runs": lambda t: jaxpr_checks.lanes(
        functions(t), [(g.x, g.u) for g in points(t)[1 : 1 + WIDTH]], lambda row: PlantArguments(t.params, *row)
    ),
    "axes": axes,
    "slopes": slopes,
    "rest": rest,
    "tick": tick,
    "seen": check_observability,
    "perfect start": perfect_start,
}
BASIC = ("shapes",)
NEEDS = {"": BASIC, "shapes": (), "seen": (), **dict.fromkeys(("slopes", "rest", "tick"), (*BASIC, "finite")),
         "perfect start": (*BASIC, "finite", "many runs")}  # fmt: skip


def findings(label: str, scenario: Scenario) -> list[Finding]:
    """Return the results of all checks of a scenario's plant."""
    return run_checks("numbers", partial(trial, label, scenario), CHECKS, NEEDS)
