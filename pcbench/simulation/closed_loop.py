"""The closed loop in a run: commands made of the estimate, the input that they become, and what is off the set point.

In a closed loop there is one observer, with a plant of its own. A run that has diverged is frozen.
"""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.protocols import Controller
from pcbench.simulation import actuator, metrics
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.problem import Layout, Memories, PerLane, Problem, State, present

Tree = TypeVar("Tree")


def before(layout: Layout, p: Problem, memories: Memories) -> tuple[Any, Any]:
    """Return a closed loop's commands of the time before 0, and the stream of what it is off its target."""
    if layout.controller is None:
        return (), ()
    ((label, observer),), controller = layout.observers, layout.controller

    def one_lane(memory: Any) -> Array:
        xhat = observer.estimate(p.gains[label], memory)
        ticks = jnp.arange(-layout.commands, 0)  # tick n stands in row n mod R
        return lax.map(lambda n: controller.before(p.control, n, xhat), ticks)  # a loop: a row at a time, not R copies

    commands = over(one_lane)(memories[label])
    return commands, metrics.start(off_target(controller, p, jnp.asarray(0), p.x0).shape[0])


def control(layout: Layout, p: Problem, k: Array, state: State) -> State:
    """Give the command of tick k in a closed loop, made of the estimate of now."""
    if layout.controller is None:
        return state
    ((label, observer),), controller = layout.observers, layout.controller

    def one_lane(k: Array, memory: Any, commands: Array) -> Array:
        def coming(i: Array) -> Array:
            return actuator.read(p.line, commands, k + i, k - 1)

        now, xhat = present(p, k, False, commands), observer.estimate(p.gains[label], memory)
        return actuator.write(commands, k, controller.command(p.control, now, xhat, coming))

    return state._replace(commands=over(one_lane)(k, state.memories[label], state.commands))


def held(p: Problem, k: Array, state: State) -> PerLane:
    """Return the input held over tick k, once it is decided: [m]."""
    return over(lambda k, commands: present(p, k, True, commands).u)(k, state.commands)


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
