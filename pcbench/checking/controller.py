"""Checks that a controller follows the protocol and stabilises the plant of a scenario.

The checks use a scenario whose loop the controller closes, with its options and its parameters.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree
from pydantic import BaseModel

from pcbench.checking import jaxpr_checks
from pcbench.checking.jaxpr_checks import WIDTH, Functions, perturb_lane
from pcbench.checking.noise_free_runs import limit_duration, noise_free, plan_cell, record_run
from pcbench.checking.targets import Finding, SkipCheck, require, run_checks
from pcbench.controllers import ControllerContext, ControllerSpec, entry_of, law_of
from pcbench.dynamics.observability import format_mode
from pcbench.errors import UserError, brief_repr
from pcbench.observers import entry_of as observer_of
from pcbench.planning import loop_setup
from pcbench.plants import estimated_of, nonlinear, states_of
from pcbench.protocols import Controller, Now
from pcbench.scenarios import Scenario
from pcbench.simulation import controller_shape_checks
from pcbench.study import controller_table
from pcbench.study.axes import COMMANDS
from pcbench.study.grid import cell_of
from pcbench.study.plugins.user_code import UserPlugin

TICKS, ROOM = 40, 8  # duration of the loop; commands in memory and in transit
TICK = 5  # at which functions are called


class LawArguments(NamedTuple):
    """The arguments of a control law's functions."""

    params: PyTree
    tick: Array
    estimate: Array  # [n]
    future_inputs: Array  # [ROOM, m] commands in transit
    memory: PyTree  # (): it has none


class Trial(NamedTuple):
    """A controller in a scenario, with its options: n states, m inputs."""

    label: str
    scenario: Scenario
    options: BaseModel
    context: ControllerContext

    @property
    def entry(self) -> ControllerSpec:
        """Return the controller's specification, which also prepares its parameters."""
        return entry_of(self.scenario)

    @property
    def law(self) -> Controller:
        """Return the functions of the controller."""
        return law_of(self.entry, self.options)

    @property
    def period_ticks(self) -> int:
        """Return the ticks between two decisions, by the option `period`."""
        return self.context.period_ticks(getattr(self.options, "period", None))


def trial(label: str, plugin: UserPlugin, scenario: Scenario, options: Mapping[str, Any]) -> tuple[Trial, str]:
    """Return a controller's trial and a text of its options; raise UserError if the options are invalid."""
    loop_plugin = scenario.user_code.get("controller")
    control = dict(scenario.loop.control) if loop_plugin and loop_plugin.code == plugin.code else {}
    network = {name: scenario.value(name) for name in ("actuator_delay", *COMMANDS)} if scenario.loop.controller else {}
    table = {"use": label, **{k: v for k, v in network.items() if v}, **control, **options}
    open_loop = scenario.with_fields(
        controller="", control={}, user_code={k: v for k, v in scenario.user_code.items() if k != "controller"}
    )
    s = controller_table.close_loop(open_loop.with_fields(actuator_delay=None), table, "options", {label: plugin})
    cell = cell_of(s)
    values = loop_setup.options(cell)
    text = ", ".join(f"{name} = {brief_repr(value)}" for name, value in values.model_dump().items())
    context = loop_setup.make_controller_context(cell, loop_setup.Reach(ROOM, ROOM), TICKS)
    return Trial(label, s, values, context), text or "it takes none"


def numbers(t: Trial) -> PyTree:
    """Return the law's parameters as arrays; raise UserError for a leaf that is not a number."""
    return jaxpr_checks.arrays(t.entry.prepare(t.options, t.context))


def make_arguments(t: Trial) -> LawArguments:
    """Return arguments of a plausible size, with the memory that the law's `start` returns."""
    params, m = numbers(t), t.context.model.B.shape[1]
    estimate = jnp.asarray(t.scenario.truth.x0) + jnp.arange(1.0, len(states_of(t.scenario)) + 1)
    memory = t.law.start(params, estimate) if t.law.start else ()
    return LawArguments(params, jnp.asarray(TICK), estimate, jnp.arange(1.0, ROOM * m + 1).reshape(ROOM, m), memory)


def functions(t: Trial) -> Functions:
    """Return the law's functions, each as a function of `LawArguments`."""
    law, start, dt = t.law, t.law.start, jnp.asarray(t.context.dt)

    def command(g: LawArguments) -> PyTree:
        u = g.future_inputs[0]  # the present input is the first in transit
        now = Now(g.tick * dt, g.tick, dt, u, lambda age: u)
        memory = (g.memory,) if start else ()
        return law.command(g.params, now, g.estimate, lambda i: g.future_inputs[jnp.minimum(i, ROOM - 1)], *memory)

    out: dict[str, Callable[[LawArguments], PyTree]] = {
        "target": lambda g: law.target(g.params, g.tick),
        "before": lambda g: law.before(g.params, g.tick - ROOM, g.estimate),
        "command": command,
    }
    return out | ({"start": lambda g: start(g.params, g.estimate)} if start else {})


def numbers_are_arrays(t: Trial) -> str:
    """Check that `prepare` returns only arrays."""
    count = len(jax.tree.leaves(numbers(t)))
    return f"prepare returns {count} array{'s' * (count != 1)}, and nothing else"


def shapes(t: Trial) -> str:
    """Check the shapes: one command per input, set points of the first states, and memory of unchanged shape."""
    n, m = t.context.model.B.shape
    sizes = controller_shape_checks.Sizes(n, len(estimated_of(t.scenario)) - n, m)
    controller_shape_checks.check(t.label, t.law, numbers(t), sizes)
    return f"{', '.join(functions(t))} return arrays of the right shapes"


def lanes(t: Trial) -> str:
    """Check that each run of a batch gives the results that it gives alone."""
    g = make_arguments(t)
    rows = [(g.estimate * (1 + i), perturb_lane(g.memory, i)) for i in range(WIDTH)]
    return jaxpr_checks.lanes(functions(t), rows, lambda row: g._replace(estimate=row[0], memory=row[1]))


def check_hold(t: Trial) -> str:
    """Check that the command is constant between decisions, for any estimate."""
    if t.period_ticks == 1:
        raise SkipCheck("its options have no period: it decides at every tick")
    g, command = make_arguments(t), jax.jit(functions(t)["command"])
    memory, commands = g.memory, []
    for tick in range(2 * t.period_ticks):
        arguments = g._replace(tick=jnp.asarray(tick), estimate=g.estimate * (1 + tick), memory=memory)
        u, memory = command(arguments) if t.law.start else (command(arguments), ())
        commands.append(np.asarray(u))
    first = next((k for k, u in enumerate(commands) if not np.array_equal(u, commands[k - k % t.period_ticks])), None)
    require(
        first is None,
        f"held: got a different command at tick {first}, between decisions every {t.period_ticks} ticks (period), expected the "
        "same; store it from start on, and decide only if now.tick % every == 0.",
    )
    return f"commands change every {t.period_ticks} ticks only"


def settles(t: Trial) -> str:
    """Check that the eigenvalues of the closed loop with state feedback are within the unit circle."""
    slowest, where = controller_table.slowest_mode(t.scenario, "settles"), t.scenario.name
    if slowest is None:
        raise SkipCheck("it has no linear law, because it uses commands in transit: write linear(options, context)")
    if sentence := controller_table.warning(t.scenario, "settles"):
        raise UserError(sentence)
    return (
        f"the closed loop on {where} has the eigenvalue {format_mode(slowest.mode)} over {slowest.period:g} s, of size "
        f"{abs(slowest.mode):.4g}"
    )


def run(t: Trial) -> str:
    """Check that a run with the true initial state and without noise stays finite."""
    observer = "ekf" if nonlinear(t.scenario) else "model-only"
    cell = cell_of(t.scenario)._replace(options={observer: observer_of(observer).options()})
    (p,) = plan_cell(noise_free(limit_duration(cell)))
    s, out = p.cell.scenario, record_run(p, noise=False)
    x = np.asarray(out.x)[:, : len(states_of(s))]
    for k in np.flatnonzero(~(np.isfinite(x).all(1) & np.isfinite(np.asarray(out.u)).all(1))):
        raise UserError(
            f"run: got a state or a command that is not finite at tick {k} ({k * s.dt:g} s) of {s.name}, from the true initial "
            "state without noise, expected finite numbers; check the law's divisions, or give other options."
        )
    at_end = ", ".join(f"{name} {v:.3g}" for (name, _), v in zip(states_of(s), x[-1], strict=True))
    return f"after {s.duration:g} s with state feedback: {at_end}; commands of {np.abs(out.u).max():.3g} at most"


CHECKS: dict[str, Callable[[Trial], str]] = {
    "numbers": numbers_are_arrays,
    "shapes": shapes,
    "purity": lambda t: jaxpr_checks.purity(functions(t), make_arguments(t)),
    "float64": lambda t: jaxpr_checks.float64(functions(t), make_arguments(t)),
    "many runs": lanes,
    "held": check_hold,
    "settles": settles,
    "run": run,
}
BASIC = ("numbers", "shapes")
NEEDS = {"": BASIC, "numbers": (), "shapes": ("numbers",), "settles": (*BASIC, "purity"), "run": (*BASIC, "many runs")}


def findings(label: str, plugin: UserPlugin, scenario: Scenario, options: Mapping[str, Any]) -> list[Finding]:
    """Return the results of all checks of a controller that closes the loop of a scenario."""
    return run_checks("options", partial(trial, label, plugin, scenario, options), CHECKS, NEEDS)
