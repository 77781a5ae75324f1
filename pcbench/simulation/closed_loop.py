"""The closed loop in a run: commands made of the estimate, the input that they become, and what is off the set point.

In a closed loop there is one observer, with a plant of its own. A run that has diverged is frozen. Commands go to the plant on
a line that is the same for all runs (`actuator`), or over a network with delays and losses of each run's own (`network`).
"""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.protocols import Controller, Now
from pcbench.simulation import actuator, metrics, network
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.problem import Layout, Memories, Problem, State, present

Tree = TypeVar("Tree")


class Started(NamedTuple):
    """What a closed loop adds to the state before tick 0; empty where the loop is open."""

    commands: Any = ()
    tracking: Any = ()
    law: Any = ()
    effort: Any = ()


def before(layout: Layout, p: Problem, memories: Memories) -> Started:
    """Return commands of the time before 0, the stream of what is off the target, what the law keeps, the effort."""
    if layout.controller is None:
        return Started()
    ((label, observer),), controller = layout.observers, layout.controller

    def one_lane(memory: Any) -> Array:
        xhat = observer.estimate(p.gains[label], memory)
        ticks = jnp.arange(-layout.commands, 0)  # tick n stands in row n mod R
        return lax.map(lambda n: controller.before(p.control, n, xhat), ticks)  # a loop: a row at a time, not R copies

    law, start = (), controller.start
    if layout.pending:
        commands = network.empty(layout.commands, layout.pending, p.network.std.shape[0])
    else:
        commands = over(one_lane)(memories[label])
    if start:
        law = over(lambda memory: start(p.control, observer.estimate(p.gains[label], memory)))(memories[label])
    return Started(
        commands,
        metrics.start(off_target(controller, p, jnp.asarray(0), p.x0).shape[0]),
        law,
        metrics.start_effort() if isinstance(p.weights, metrics.Weights) else (),
    )


def control(layout: Layout, p: Problem, k: Array, state: State, drawn: Any = ()) -> State:
    """Give the command of tick k in a closed loop, made of the estimate of now; `drawn` is the network's (`network.Drawn`)."""
    if layout.controller is None:
        return state
    ((label, observer),), controller = layout.observers, layout.controller

    def one_lane(k: Array, memory: Any, commands: Any, law: Any, effort: Any, x: Array, drawn: Any) -> Any:
        def coming(i: Array) -> Array:
            sent = commands.sent if layout.pending else commands
            return actuator.read(p.line, sent, k + i, k - 1)

        now, xhat = present(p, k, False, commands), observer.estimate(p.gains[label], memory)
        command: Any = controller.command
        if controller.start:
            c, law = command(p.control, now, xhat, coming, law)
        else:
            c = command(p.control, now, xhat, coming)
        commands = network.send(p.network, k, commands, c, drawn) if layout.pending else actuator.write(commands, k, c)
        if isinstance(p.weights, metrics.Weights):
            effort = metrics.spend(effort, p.weights, k, x, pushed(present(p, k, True, commands), commands).u)
        return commands, law, effort

    given = state.memories[label], state.commands, state.law, state.effort, state.x, drawn
    commands, law, effort = over(one_lane)(k, *given)
    return state._replace(commands=commands, law=law, effort=effort)


def pushed(now: Now, commands: Any) -> Now:
    """Return the present as it is for the plant: its input with the noise that no observer is told."""
    return now._replace(u=now.u + commands.noise) if isinstance(commands, network.Commands) else now


def aims(layout: Layout, p: Problem, k: Array) -> Array:
    """Return the set point of tick k, [r]; of an open loop [0]."""
    return layout.controller.target(p.control, k) if layout.controller else jnp.zeros(0)


def off_target(controller: Controller, p: Problem, k: Array, x: Array) -> Array:
    """Return the set point less the state, of the states that are to follow it: [r]."""
    target = controller.target(p.control, k)
    return target - x[: target.shape[0]]


def unless_diverged(watches: dict[str, metrics.Watch], new: Tree, old: Tree) -> Tree:
    """Keep a diverged run of a closed loop as it was when it diverged: its lane is frozen.

    Ticks and sample numbers go on: they are the same in all lanes, and loops over them are to stay shared.
    """
    bad = jnp.any(jnp.stack([watch.first_bad >= 0 for watch in watches.values()])) if watches else jnp.asarray(False)

    def one(a: Array, b: Array) -> Array:
        number = jnp.issubdtype(jnp.result_type(b), jnp.floating)
        return jnp.where(bad, b, a) if number else a.astype(jnp.result_type(b))

    return jax.tree.map(one, new, old)
