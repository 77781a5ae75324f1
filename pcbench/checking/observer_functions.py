"""An observer's functions, each with all that it takes, as checks ask them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pcbench.checking.fixtures import Case, Trial
from pcbench.checking.jaxpr_checks import Asked
from pcbench.protocols import Arrival
from pcbench.simulation.types import present

TICK, AGE = 5, 2  # where the functions are asked: a tick and an age that every schedule has


class Given(NamedTuple):
    """With what the functions are asked."""

    gains: Any
    memory: Any
    value: Any  # [q]
    snapshot: Any  # [r]
    xhat0: Any  # [n]
    inputs: Any  # [N+1, m]


def given(t: Trial, case: Case, gains: Any) -> Given:
    """Return arguments of a plausible size, with a memory as the observer makes it."""
    o, p = t.observer, case.problem
    n, q = p.x0.shape[0], p.noise_std.shape[0]
    gains, u = jax.tree.map(jnp.asarray, gains), jnp.asarray(p.inputs)
    xhat0 = jnp.asarray(p.x0) + jnp.arange(1.0, n + 1)

    def start(gains: Any, xhat0: Any) -> Any:
        memory = o.init(gains, xhat0)
        return memory, jnp.asarray(o.snapshot(gains, memory, _now(p, u, False)))

    memory, snapshot = jax.jit(start)(gains, xhat0)
    return Given(gains, memory, jnp.arange(1.0, q + 1), snapshot, xhat0, u)


def asked(t: Trial, case: Case) -> list[Asked]:
    """Return every function of the observer."""
    o, p = t.observer, case.problem
    q = p.noise_std.shape[0]

    def jump(g: Given) -> Any:
        arrival = Arrival(g.value, jnp.ones(q, bool), jnp.full(q, AGE), jnp.ones(q, int), g.snapshot, jnp.asarray(AGE))
        return o.jump(g.gains, g.memory, _now(p, g.inputs, False), arrival)

    return [
        Asked("init", lambda g: o.init(g.gains, g.xhat0)),
        Asked("snapshot", lambda g: o.snapshot(g.gains, g.memory, _now(p, g.inputs, False))),
        Asked("jump", jump),
        Asked("flow", lambda g: o.flow(g.gains, g.memory, _now(p, g.inputs, True))),
        Asked("estimate", lambda g: o.estimate(g.gains, g.memory)),
    ]


def _now(p: Any, inputs: Any, decided: bool) -> Any:
    return present(p._replace(inputs=inputs, dt=jnp.asarray(p.dt)), jnp.asarray(TICK), decided)
