"""The closed loop in a run: commands computed from the estimate, the input that follows, and the tracking error.

A closed loop has one observer and its own plant. A run that has diverged is frozen. Commands reach the plant in one of two
ways (`command_network`):

- through an actuator delay that is the same for all runs
- over a network that delays and loses the commands of each run at random
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
    """The state that a closed loop adds before tick 0; empty for an open loop."""

    commands: PyTree = ()
    tracking: PyTree = ()
    law: PyTree = ()
    effort: PyTree = ()


def first_loop_state(layout: Layout, p: GridPointParams, memories: Memories) -> LoopState:
    """Return the commands before tick 0, the tracking-error sums, the controller's memory and the control cost."""
    if layout.controller is None:
        return LoopState()
    ((label, observer),), controller = layout.observers, layout.controller
    xhat = observer.estimate(p.gains[label], memories[label])
    if layout.pending:
        commands: PyTree = command_network.empty(layout.commands, layout.pending, p.network.std.shape[0])
    else:
        ticks = jnp.arange(-layout.commands, 0)  # tick n is in row n mod R
        # one row at a time instead of R copies
        commands = lax.map(lambda n: controller.before(p.control, n, xhat), ticks)
    return LoopState(
        commands,
        metrics.zero_sums(tracking_error(controller, p, jnp.asarray(0), p.x0).shape[0]),
        controller.start(p.control, xhat) if controller.start else (),
        metrics.ControlCost(jnp.zeros(()), jnp.zeros(())) if isinstance(p.weights, metrics.Weights) else (),
    )


def add_command_noise(now: Now, commands: PyTree) -> Now:
    """Return the present with the noisy input that the plant receives; observers do not see this noise."""
    return now._replace(u=now.u + commands.noise) if isinstance(commands, command_network.Commands) else now


def set_point_at(layout: Layout, p: GridPointParams, k: Array) -> Array:
    """Return the set point of tick k, [r]; [0] for an open loop."""
    return layout.controller.target(p.control, k) if layout.controller else jnp.zeros(0)


def tracking_error(controller: Controller, p: GridPointParams, k: Array, x: Array) -> Array:
    """Return set point minus state for the states that follow it, [r]."""
    target = controller.target(p.control, k)
    return target - x[: target.shape[0]]


def unless_diverged(watches: dict[str, metrics.SettlingState], new: Tree, old: Tree) -> Tree:
    """Return `old` for a closed-loop run that has diverged, else `new`.

    The tick and sample numbers are not frozen: they are the same in all runs, so loops over them stay shared.
    """
    is_bad = [watch.first_bad >= 0 for watch in watches.values()]
    diverged = jnp.any(jnp.stack(is_bad)) if is_bad else jnp.asarray(False)

    def one(a: Array, b: Array) -> Array:
        is_float = jnp.issubdtype(jnp.result_type(b), jnp.floating)
        return jnp.where(diverged, b, a) if is_float else a.astype(jnp.result_type(b))

    return jax.tree.map(one, new, old)
