"""Does a plant keep to what pcbench asks of one? `pcbench.make_plant` has asked the first things itself.

Checks of a plant's functions where they are: shapes, finite values, slopes, and the numbers that change nothing.

Checks of how a plant moves: rest, the tick, what its outputs show, and a perfect start of an observer on it.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pcbench.checking import jaxpr_checks
from pcbench.checking.fixtures import NEAR
from pcbench.checking.noise_free_runs import WIDTH, in_parts, planned, quiet, recorded, same_in_lanes
from pcbench.checking.plant_fixtures import (
    EVERY,
    Given,
    Trial,
    asked,
    entries_of,
    moves,
    now_of,
    points,
    shown_at,
    trial,
)
from pcbench.checking.run_checks import LINEAR, ROUNDING
from pcbench.checking.targets import Finding, Noted, Skipped, ask, require
from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import discretize_zoh
from pcbench.dynamics.observability import decays, unobservable
from pcbench.dynamics.observability import shown as shown_mode
from pcbench.errors import UserError, raised
from pcbench.observers import entry_of as observer_of
from pcbench.plants import numbers_of
from pcbench.plants.nonlinear import REST
from pcbench.scenarios import Loop, Sampling, Scenario
from pcbench.study import times
from pcbench.study.grid import cell_of

STEP, CLOSE, KINK = 1e-5, 1e-6, 1e-2  # of the spread; of the slopes; of those from either side


def shapes(t: Trial) -> str:
    """Every function returns a number for each state, output or unknown."""
    for a in asked(t):
        want = (len(entries_of(t, a.name)),)
        try:
            found = jax.eval_shape(lambda g, a=a: jnp.asarray(a.f(g)), points(t)[0])
        except Exception as error:
            raise UserError(
                f"shapes: {a.name} cannot be traced ({raised(error)}), expected pure jax.numpy code for one run, with "
                "jnp.where in place of if; mend that line."
            ) from None
        require(
            found.shape == want,
            f"shapes: got an array of shape {list(found.shape)} from {a.name}, expected {list(want)}, a number for each of "
            f"{', '.join(entries_of(t, a.name))}; return all of them.",
        )
    return f"{', '.join(a.name for a in asked(t))} return what they should"


def purity(t: Trial) -> str:
    """The same input gives the same output; nothing is kept outside, no argument is changed."""
    return jaxpr_checks.purity(asked(t), points(t)[1])


def float64(t: Trial) -> str:
    """No number is rounded to fewer bits than it came with."""
    return jaxpr_checks.float64(asked(t), points(t)[1])


def lanes(t: Trial) -> str:
    """Each lane of a batch is what the run gives alone."""
    rows = [(g.x, g.u) for g in points(t)[1 : 1 + WIDTH]]
    return same_in_lanes(asked(t), rows, lambda own: Given(t.params, *own))


def finite(t: Trial) -> str:
    """Values are numbers at the operating point and around it."""
    for a in asked(t):
        f = jax.jit(a.f)
        for g in points(t):
            value = np.asarray(f(g))
            for i in np.flatnonzero(~np.isfinite(value)):
                raise UserError(
                    f"finite: got {value[i]} for {entries_of(t, a.name)[i]} in {a.name} at {shown_at(t, g)}, expected a "
                    "number; guard the root or the quotient there, or name a --scenario whose prior_std stays where the plant "
                    "can be."
                )
    return f"finite at the operating point and at {len(points(t)) - 1} points around it"


def slopes(t: Trial) -> str:
    """What jax and the linear model take for slopes are those of the values, from either side."""
    linear = t.model.known is None and (
        t.entry.model is None or t.entry.residual is not None
    )  # then the model is the slope
    motion, A, B = moves(t), t.model.A, t.model.B
    if motion.name == "step" and not t.model.discrete:
        A, B = discretize_zoh(A, B, t.scenario.dt)
    for a, model in (
        (motion, (A, B)),
        (next(a for a in asked(t) if a.name == "output"), (t.model.C, t.model.feedthrough)),
    ):
        f, here = jax.jit(a.f), points(t)
        derived = jax.jit(jax.jacfwd(a.f))
        for i, g in enumerate(here[: 1 + WIDTH]):
            slope = derived(g)
            known = model if not i and linear else None
            for name, size, k in (("x", t.spread, 0), ("u", t.reach, 1)):
                said = np.asarray(known[k] if known else getattr(slope, name)) * size
                _compare(t, a.name, f, g, name, size, said, "the linear model" if known else "jax")
    return "jax and the linear model agree with differences of the values"


def _compare(
    t: Trial, function: str, f: Any, g: Given, name: str, size: np.ndarray, said: np.ndarray, who: str
) -> None:
    """Raise UserError where slopes, times the spread, are not those of values a little to either side."""
    at, names = np.asarray(f(g)), t.states if name == "x" else [f"u{i + 1}" for i in range(len(size))]

    def beside(j: int, sign: int) -> np.ndarray:
        moved = getattr(g, name).at[j].add(sign * STEP * size[j])
        return np.asarray(f(g._replace(**{name: moved})))

    up, down = ((np.stack([beside(j, s) for j in range(len(size))], 1) - at[:, None]) * s / STEP for s in (1, -1))
    scale = np.abs(said).max() + np.abs(at)[:, None] + np.abs(up)
    for found, allowed in (((up + down) / 2, CLOSE), (up, KINK), (down, KINK)):
        bad = np.argwhere(~(np.abs(found - said) <= allowed * scale + 1e-300))
        if bad.size:
            i, j = bad[0]
            raise UserError(
                f"slopes: got {said[i, j] / size[j]:.6g} from {who} and {found[i, j] / size[j]:.6g} from differences for the "
                f"slope of {entries_of(t, function)[i]} in {function} by {names[j]}, at {shown_at(t, g)}, expected the same; "
                "smooth the kink there, or leave out what hides a slope (stop_gradient, NumPy, rounding)."
            )


def axes(t: Trial) -> str:
    """Each number that a study may vary changes something."""
    if not t.axes:
        raise Skipped("it has no numbers that a study may vary")
    numbers, idle = numbers_of(t.scenario), []
    fs = [jax.jit(a.f) for a in asked(t) if a.name != "unknown"]
    for name in t.axes:
        value = getattr(numbers, name)
        other = t.entry.prepare(numbers._replace(**{name: 1.01 * value or 0.01}), t.scenario.dt, 10)
        params = jax.tree.map(jnp.asarray, other)
        if all(np.array_equal(f(g), f(g._replace(params=params))) for f in fs for g in points(t)):
            idle.append(f"plant.{name}")
    if idle:
        raise Noted(
            f"around the operating point nothing changes with {', '.join(idle)}: a study that varies it there gets equal cells"
        )
    return "each of its numbers changes the plant"


EXACT = 1e-3  # part of a state that the ticks of a horizon may be off together


def rest(t: Trial) -> str:
    """At the operating point nothing moves by itself."""
    a, g = moves(t), points(t)[0]
    moving = np.asarray(a.f(g))
    if t.entry.residual is not None:
        moving = t.entry.residual(numbers_of(t.scenario))
    bad = np.flatnonzero(np.abs(moving) > REST * (1 + np.abs(t.model.A).max()))
    if bad.size:
        rates = ", ".join(f"{t.states[i]} by {moving[i]:.4g}" for i in bad)
        raise Noted(
            f"no equilibrium: {rates} a {'tick' if a.name == 'step' else 'second'} at the operating point: observers that need "
            "a linear model refuse the plant there, ekf does not"
        )
    return "the operating point is an equilibrium"


def tick(t: Trial) -> str:
    """A tick of the plant is as exact as two of half its length."""
    if moves(t).name == "step":
        raise Skipped("it is given by its step: a tick is what that says")
    dt, ticks = t.scenario.dt, times.whole(t.scenario.duration, t.scenario)
    own, by = jax.jit(next(a.f for a in asked(t) if a.name == "step")), stepping(t)
    off = max(_off(t, g, own(g), by(by(g, dt / 2), dt / 2).x) for g in points(t))
    if not off * ticks <= EXACT:
        fine = next((h for h in finer(dt) if together(t, by, h) <= EXACT), None)
        advice = (
            f"write dt = {fine:g}, or less"
            if fine
            else "see whether step is what field says, or leave out what is so fast"
        )
        raise UserError(
            f"tick: got a tick of {dt:g} s that is off by {off:.2g} of a state, {ticks} times in {t.scenario.duration:g} s, "
            f"expected {EXACT:g} at most in all; {advice}."
        )
    return f"a tick of {dt:g} s is off by {off:.2g} of a state, {off * ticks:.2g} in {t.scenario.duration:g} s"


def stepping(t: Trial) -> Callable[[Given, float], Given]:
    """Return what moves a point by one Runge-Kutta step of the field, of so many seconds."""
    field = next(a.f for a in asked(t) if a.name == "field")

    @jax.jit
    def step(g: Given, h: Array) -> Given:
        start = now_of(t, g.u).t
        return g._replace(x=rk4(lambda s, x: field(g._replace(x=x)), start, g.x, h))

    return lambda g, h: step(g, jnp.asarray(h))


def _off(t: Trial, g: Given, one: Any, two: Any) -> float:
    """How far two results of a tick are apart, in parts of the state's spread; infinite where either is not finite."""
    off = np.abs(np.asarray(one) - np.asarray(two)) / np.maximum(t.spread, np.abs(np.asarray(g.x)))
    return float(off.max()) if np.isfinite(off).all() else np.inf


def together(t: Trial, by: Callable[[Given, float], Given], dt: float) -> float:
    """Return what all ticks of the horizon may be off together, each a Runge-Kutta step of dt."""
    each = (_off(t, g, by(g, dt).x, by(by(g, dt / 2), dt / 2).x) for g in points(t))
    return max(each) * t.scenario.duration / dt


def finer(dt: float) -> list[float]:
    """Return the ticks shorter than dt that are 1, 2 or 5 in the first digit, down to a millionth."""
    top = int(np.floor(np.log10(dt))) + 1
    return [h for p in range(7) for d in (5, 2, 1) if (h := float(f"{d}e{top - 1 - p}")) < dt * (1 - 1e-9)]


def seen(t: Trial) -> str:
    """Every mode of the linear model shows in some output."""
    hidden = unobservable(t.model.A, t.model.C)
    lasting = [shown_mode(mode) for mode in hidden if not decays(mode, t.model.discrete)]
    if lasting:
        raise Noted(
            f"no output shows the mode {' and '.join(lasting)}, which does not decay: no observer can find the state; measure "
            "another output"
        )
    if hidden:
        raise Noted(
            f"no output shows the mode {' and '.join(map(shown_mode, hidden))}, which decays: observers that place every pole "
            "refuse the plant, kf and ekf do not"
        )
    return "every mode shows in some output"


def perfect_start(t: Trial) -> str:
    """Observers that know the plant have no error on it: true start, no noise."""
    if t.model.known is not None:
        raise Skipped("its unknown input has a known part, which the linear model leaves out")
    away = t.entry.model is not None or t.entry.successor is not None
    still = t.entry.residual is not None and not t.entry.residual(numbers_of(t.scenario)).any()
    name, size = ("ekf", 1.0) if away and not still else ("model-only", NEAR if away else 1.0)
    q, every = len(t.model.C), EVERY * t.scenario.dt
    plain = t.scenario._replace(
        loop=Loop(input="zero"), sampling=Sampling((every,) * q, (every,) * q, (1e-3,) * q), duration=4 * every
    )
    s = plain.having(x0=tuple(map(float, size * t.spread)), steady_start=t.scenario.dt)
    cell = cell_of(s)._replace(options={name: observer_of(name).options()})
    (p,) = planned(quiet(cell))
    u = size * t.reach * np.random.default_rng(7).normal(size=p.problem.inputs.shape)
    e = in_parts(p, recorded(p, noise=False, inputs=u))[name]
    allowed = LINEAR if size == NEAR else ROUNDING
    for k, i in np.argwhere(~(e <= allowed)):
        raise UserError(
            f"perfect start: got an error of {e[k, i]:.2g} of the largest state in {t.states[i]} at tick {k}, where {name} "
            "knows plant and start, expected none; let step be what field or the linear model says, under now.u."
        )
    return f"{name} has no error from the true start" + (", near the operating point" if size == NEAR else "")


CHECKS: dict[str, Callable[[Trial], str]] = {
    "shapes": shapes,
    "purity": purity,
    "float64": float64,
    "finite": finite,
    "lanes": lanes,
    "axes": axes,
    "slopes": slopes,
    "rest": rest,
    "tick": tick,
    "seen": seen,
    "perfect start": perfect_start,
}
BASIC = ("shapes",)
NEEDS = {
    "": BASIC,
    "shapes": (),
    "slopes": (*BASIC, "finite"),
    "rest": (*BASIC, "finite"),
    "tick": (*BASIC, "finite"),
    "seen": (),
    "perfect start": (*BASIC, "finite", "lanes"),
}


def findings(label: str, scenario: Scenario) -> list[Finding]:
    """Return what every check says of the plant of a scenario."""
    return ask("numbers", partial(trial, label, scenario), CHECKS, NEEDS)
