"""What a controller is tried on: a scenario whose loop it closes, with its options and its numbers."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import BaseModel

from pcbench.checking.jaxpr_checks import Asked
from pcbench.controllers import ControllerContext, ControllerSpec, entry_of, law_of
from pcbench.errors import UserError, shown
from pcbench.planning import loop_setup
from pcbench.plants import states_of
from pcbench.protocols import Controller, Now
from pcbench.scenarios import Scenario
from pcbench.study import controller_table
from pcbench.study.axes import COMMANDS
from pcbench.study.grid import cell_of
from pcbench.study.plugins.user_code import Own

TICKS, ROOM, TICK = (
    40,
    8,
    5,
)  # the horizon of its numbers; commands kept and on their way; the tick at which functions are asked


class Given(NamedTuple):
    """What a law's functions take."""

    params: Any
    tick: Array
    estimate: Array  # [n]
    coming: Array  # [ROOM, m] inputs on their way
    kept: Any  # what it keeps; () where it keeps nothing


class Trial(NamedTuple):
    """A controller in a scenario, with its options. n states, m inputs."""

    label: str
    scenario: Scenario
    options: BaseModel
    told: ControllerContext

    @property
    def entry(self) -> ControllerSpec:
        """Return the controller with what makes its numbers."""
        return entry_of(self.scenario)

    @property
    def law(self) -> Controller:
        """Return its functions."""
        return law_of(self.entry, self.options)

    @property
    def every(self) -> int:
        """Return the ticks between decisions that its options ask for."""
        return self.told.every(getattr(self.options, "period", None))


def trial(label: str, mine: Own, scenario: Scenario, options: Mapping[str, Any]) -> tuple[Trial, str]:
    """Return a controller's trial and what its options are; raise UserError where they cannot be made, or do not fit."""
    same = scenario.own.get("controller")
    control = dict(scenario.loop.control) if same and same.code == mine.code else {}
    network = {name: scenario.value(name) for name in ("actuator_delay", *COMMANDS)} if scenario.loop.controller else {}
    given = {"use": label, **{k: v for k, v in network.items() if v}, **control, **options}
    opened = scenario.having(
        controller="", control={}, own={k: v for k, v in scenario.own.items() if k != "controller"}
    )
    s = controller_table.closed(opened.having(actuator_delay=None), given, "options", {label: mine})
    cell = cell_of(s)
    made = loop_setup.options(cell)
    said = ", ".join(f"{name} = {shown(value)}" for name, value in made.model_dump().items())
    return Trial(label, s, made, loop_setup.told(cell, loop_setup.Reach(ROOM, ROOM), TICKS)), said or "it takes none"


def numbers(t: Trial) -> Any:
    """Return the law's numbers as arrays; raise UserError for what is none."""
    made = t.entry.prepare(t.options, t.told)
    for leaf in jax.tree.leaves(made):
        if not isinstance(leaf, np.ndarray | jax.Array | np.generic | float | int):
            raise UserError(
                f"numbers: got {shown(leaf)} among what prepare returns, expected arrays of numbers only; keep words and "
                "functions out of it."
            )
    return jax.tree.map(jnp.asarray, made)


def given(t: Trial) -> Given:
    """Return arguments of a plausible size, with what the law keeps as it makes it."""
    params, m = numbers(t), t.told.model.B.shape[1]
    estimate = jnp.asarray(t.scenario.truth.x0) + jnp.arange(1.0, len(states_of(t.scenario)) + 1)
    kept = t.law.start(params, estimate) if t.law.start else ()
    return Given(params, jnp.asarray(TICK), estimate, jnp.arange(1.0, ROOM * m + 1).reshape(ROOM, m), kept)


def asked(t: Trial) -> list[Asked]:
    """Return the law's functions."""
    law: Any = t.law

    def command(g: Given) -> Any:
        kept = (g.kept,) if law.start else ()
        return law.command(g.params, now_of(t, g), g.estimate, lambda i: g.coming[jnp.minimum(i, ROOM - 1)], *kept)

    out = [
        Asked("target", lambda g: law.target(g.params, g.tick)),
        Asked("before", lambda g: law.before(g.params, g.tick - ROOM, g.estimate)),
        Asked("command", command),
    ]
    return [*out, Asked("start", lambda g: law.start(g.params, g.estimate))] if law.start else out


def now_of(t: Trial, g: Given) -> Now:
    """Return the present of a tick, with the input that is held as the first on its way."""
    dt = jnp.asarray(t.told.dt)
    return Now(g.tick * dt, g.tick, dt, g.coming[0], lambda age: g.coming[0])
