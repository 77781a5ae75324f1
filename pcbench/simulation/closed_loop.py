"""The closed loop in a run: commands made of the estimate, the input that they become, and what is off the set point.

In a closed loop there is one observer, with a plant of its own. A run that has diverged is frozen. Commands go to the plant on
a line that is the same for all runs (`command_network`), or over a network with delays and losses of each run's own
(`command_network`).
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.protocols import Controller, Now
from pcbench.simulation import command_network, metrics
from pcbench.simulation.types import GridPointParams, Layout, Memories

Tree = TypeVar("Tree")


class LoopState(NamedTuple):
    """What a closed loop adds to the state before tick 0; empty where the loop is open."""

    commands: PyTree = ()
    tracking: PyTree = ()
    law: PyTree = ()
    effort: PyTree = ()


def before(layout: Layout, p: GridPointParams, memories: Memories) -> LoopState:
    """Return commands of the time before 0, the stream of what is off the target, what the law keeps, the effort."""
    if layout.controller is None:
        return LoopState()
    ((label, observer),), controller = layout.observers, layout.controller
    xhat = observer.estimate(p.gains[label], memories[label])
    if layout.pending:
        commands: PyTree = command_network.empty(layout.commands, layout.pending, p.network.std.shape[0])
    else:
        ticks = jnp.arange(-layout.commands, 0)  # tick n stands in row n mod R
        commands = lax.map(lambda n: controller.before(p.control, n, xhat), ticks)  # a row at a time, not R copies
    return LoopState(
        commands,
        metrics.start(off_target(controller, p, jnp.asarray(0), p.x0).shape[0]),
        controller.start(p.control, xhat) if controller.start else (),
        metrics.start_effort() if isinstance(p.weights, metrics.Weights) else (),
    )


def add_command_noise(now: Now, commands: PyTree) -> Now:
    """Return the present as it is for the plant: its input with the noise that no observer is told."""
    return now._replace(u=now.u + commands.noise) if isinstance(commands, command_network.Commands) else now


def aims(layout: Layout, p: GridPointParams, k: Array) -> Array:
    """Return the set point of tick k, [r]; of an open loop [0]."""
    return layout.controller.target(p.control, k) if layout.controller else jnp.zeros(0)


def off_target(controller: Controller, p: GridPointParams, k: Array, x: Array) -> Array:
    """Return the set point less the state, of the states that are to follow it: [r]."""
    target = controller.target(p.control, k)
    return target - x[: target.shape[0]]


def unless_diverged(watches: dict[str, metrics.SettlingState], new: Tree, old: Tree) -> Tree:
    """Keep a diverged run of a closed loop as it was when it diverged: its lane is frozen.

    Ticks and sample numbers go on: they are the same in all lanes, and loops over them are to stay shared.
    """
    bad = jnp.any(jnp.stack([watch.first_bad >= 0 for watch in watches.values()])) if watches else jnp.asarray(False)

    def one(a: Array, b: Array) -> Array:
        number = jnp.issubdtype(jnp.result_type(b), jnp.floating)
        return jnp.where(bad, b, a) if number else a.astype(jnp.result_type(b))

    return jax.tree.map(one, new, old)
