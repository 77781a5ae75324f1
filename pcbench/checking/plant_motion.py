"""Checks of how a plant moves: rest, the tick, what its outputs show, and a perfect start of an observer on it."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pcbench.checking.fixtures import NEAR
from pcbench.checking.noise_free_runs import in_parts, planned, quiet, recorded
from pcbench.checking.plant_fixtures import EVERY, Given, Trial, asked, moves, now_of, points
from pcbench.checking.result import Noted, Skipped
from pcbench.checking.run_checks import LINEAR, ROUNDING
from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.observability import decays, unobservable
from pcbench.dynamics.observability import shown as shown_mode
from pcbench.errors import UserError
from pcbench.observers import entry_of as observer_of
from pcbench.plants import numbers_of
from pcbench.plants.nonlinear import REST
from pcbench.scenarios import Loop, Sampling
from pcbench.study import times
from pcbench.study.grid import cell_of

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
