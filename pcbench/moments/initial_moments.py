"""The joint state before tick 0, as a function of what a run draws for its start."""

from typing import Any

import jax.numpy as jnp
from jax import Array

from pcbench.simulation.closed_loop import before
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import Layout, Packet


def begin(layout: Layout, p: Any, k: Array, state: Any, drawn: Array, rest: Any) -> Run:
    """Return the state before tick 0 of one cell; drawn [2 n], of mean 0 and variance 1, for the plant and for the estimate."""
    n = p.x0.shape[0]
    x = p.x0 + p.spread0 @ drawn[:n] if layout.random_initial_state else jnp.asarray(p.x0) * 1.0
    scatter = p.scatter * drawn[n:] / jnp.sqrt(3.0) if layout.scattered else 0.0  # of a uniform number in -1 .. 1
    xhat0 = p.xhat0 + scatter
    memories = {label: o.init(p.gains[label], xhat0) for label, o in layout.observers}
    loop = before(layout, p, memories)
    return Run(
        x=x,
        memories=memories,
        flight=Packet((), {}),  # `events.Moving` has what is on the network
        streams={},
        watches={},
        commands=loop.commands,
        law=loop.law,
    )
