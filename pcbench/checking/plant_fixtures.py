"""What a plant is tried on: its numbers as observers know them, points around its operating point, a tick.

With a scenario, its tick, its horizon and the spread of its start; else 1 ms (or the tick of a plant's `step`), 10 s, and a
tenth of every state at the operating point, or of 1 where that is 0.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pcbench.checking.jaxpr_checks import Asked
from pcbench.dynamics.linear import Model
from pcbench.errors import UserError, shown
from pcbench.plants import PlantSpec, entry_of, numbers_of, parameters_of, signals_of, states_of
from pcbench.protocols import Now
from pcbench.scenarios import Belief, Loop, Sampling, Scenario, Scoring, Truth

SHARE, EVERY, POINTS, TICK = (
    0.1,
    20,
    8,
    5,
)  # of a state; ticks between samples; points; the tick at which functions are asked


class Given(NamedTuple):
    """What a plant's functions take."""

    params: Any
    x: Array  # [n]
    u: Array  # [m]


class Trial(NamedTuple):
    """A plant in a scenario, with its numbers. n states, m inputs."""

    label: str
    scenario: Scenario
    params: Any
    model: Model
    spread: np.ndarray  # [n] of the state around the operating point
    reach: np.ndarray  # [m] of the input

    @property
    def entry(self) -> PlantSpec:
        """Return the plant."""
        return entry_of(self.scenario)

    @property
    def states(self) -> list[str]:
        """Return the names of its states."""
        return [name for name, _ in states_of(self.scenario)]

    @property
    def axes(self) -> list[str]:
        """Return the names of its numbers that a study may vary."""
        return parameters_of(self.entry)


def trial(label: str, scenario: Scenario) -> tuple[Trial, str]:
    """Return a plant's trial, and what it is; raise UserError where its numbers cannot be made."""
    entry, numbers = entry_of(scenario), numbers_of(scenario)
    params = entry.prepare(numbers, scenario.dt, 2 * TICK)
    for leaf in jax.tree.leaves(params):
        if not isinstance(leaf, np.ndarray | jax.Array | np.generic | float | int):
            raise UserError(
                f"numbers: got {shown(leaf)} among what prepare returns, expected arrays of numbers only; keep words and "
                "functions out of it."
            )
    model, n = entry.nominal(numbers), len(states_of(scenario))
    (m, q) = (np.shape(model.B)[-1], len(model.C))
    for name, found, shape in (("A", model.A, (n, n)), ("B", model.B, (n, m)), ("C", model.C, (q, n))):
        if np.shape(found) != shape:
            raise UserError(
                f"numbers: got {name} of shape {list(np.shape(found))} in the linear model of {n} states, expected "
                f"{list(shape)}; give each state a name and a row."
            )
    _, u0 = _point(entry, n, m)
    spread = np.array([std or SHARE for std in scenario.belief.prior_std])
    made = Trial(label, scenario, jax.tree.map(jnp.asarray, params), model, spread, SHARE * np.where(u0, abs(u0), 1.0))
    axes = f"; axes: {', '.join(f'plant.{name}' for name in made.axes)}" if made.axes else ""
    return made, f"{n} states, {m} inputs, {q} outputs{axes}"


def alone(label: str, entry: PlantSpec, carried: dict[str, Any]) -> Scenario:
    """Return a scenario for nothing but the plant, which it has as `carried`."""
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
        scoring=Scoring((*start, *unknowns), np.inf, steady_start=dt),
        dt=dt,
    ).having(**carried)


def _point(entry: PlantSpec, n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """The operating point where the plant has one: x0 [n], u0 [m]; else zeros."""
    x0, u0 = entry.operating_point or ((0.0,) * n, (0.0,) * m)
    return np.array(x0), np.array(u0)


def now_of(t: Trial, u: Array) -> Now:
    """Return the present with u held since ever."""
    dt = jnp.asarray(t.scenario.dt)
    return Now(TICK * dt, jnp.asarray(TICK), dt, u, lambda age: u)


def asked(t: Trial) -> list[Asked]:
    """Return the plant's functions."""
    plant = t.entry.plant
    each = {"step": plant.step, "output": plant.output, "field": plant.field, "unknown": plant.unknown}

    def one(f: Any) -> Any:
        return lambda g: f(g.params, now_of(t, g.u), g.x)

    return [Asked(name, one(f)) for name, f in each.items() if f is not None]


def moves(t: Trial) -> Asked:
    """Return what says how the state moves: the field, or the step of a plant that has none."""
    return next(
        a for a in asked(t) if a.name == ("step" if t.entry.plant.field is None or t.model.discrete else "field")
    )


def points(t: Trial) -> list[Given]:
    """Return the operating point, and others around it."""
    r = np.random.default_rng(7).uniform(-1, 1, (POINTS, len(t.spread) + len(t.reach)))
    rows = np.vstack([np.zeros(r.shape[1]), r]) * np.concatenate([t.spread, t.reach])
    n = len(t.spread)
    return [Given(t.params, jnp.asarray(row[:n]), jnp.asarray(row[n:])) for row in rows]


def shown_at(t: Trial, g: Given) -> str:
    """Return a point in words: state by state, and the input."""
    x = ", ".join(f"{name} {v:.3g}" for name, v in zip(t.states, np.asarray(g.x), strict=True))
    return f"{x} and u = {shown(np.asarray(g.u).round(4).tolist())} from the operating point"


def entries_of(t: Trial, name: str) -> list[str]:
    """Return what the entries of a function's value are called."""
    if name == "output":
        return [f"output {i + 1}" for i in range(len(t.model.C))]
    return [signal for signal, _ in signals_of(t.scenario)][len(t.states) :] if name == "unknown" else t.states
