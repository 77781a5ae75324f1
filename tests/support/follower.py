"""An observer of a user's own whose ticks depend on its gain once a sample has arrived: it follows the one that it holds."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from pydantic import BaseModel

import pcbench


class Gains(NamedTuple):
    Phi: Any
    Gamma: Any
    L: Any


class Options(BaseModel):
    L: float = pcbench.tunable(0.0)


def design(context, options):
    Phi, Gamma = pcbench.discretize_zoh(context.model.A, context.model.B, context.dt)
    return pcbench.Design(Gains(Phi, Gamma, options.L), pcbench.no_certificate("for tests"))


def correct(gains, memory, now, far):
    """One tick; `far` says how the distance from the sample is weighed."""
    xhat, held, on = memory
    return gains.Phi @ xhat + gains.Gamma @ now.u + gains.L * on * far(held - xhat), held, on


follow = pcbench.Observer(
    init=lambda gains, xhat0: (xhat0, jnp.zeros(1), jnp.zeros(())),
    snapshot=lambda gains, memory, now: jnp.zeros(0),
    jump=lambda gains, memory, now, arrival: (memory[0], arrival.value, jnp.ones(())),
    flow=lambda gains, memory, now: correct(gains, memory, now, lambda e: e),
    estimate=lambda gains, memory: memory[0],
)

follow_by_steps = follow._replace(flow=lambda gains, memory, now: correct(gains, memory, now, jnp.sign))
