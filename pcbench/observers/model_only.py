"""model-only: simulation of the model from xhat0 without measurements; every observer should have a smaller error.

xhat(0) = xhat0,   xhat' = A xhat + B u
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from pcbench.dynamics import linear
from pcbench.protocols import Arrival, Leaf, Now, Observer
from pcbench.synthesis.certificate import NO_GAIN, Certificate, Design, DesignContext


class Gains(NamedTuple):
    """n states, m inputs."""

    Phi: Float[Leaf, "n n"]  # one tick
    Gamma: Float[Leaf, "n m"]
    A: Float[Leaf, "n n"]  # of the field
    B: Float[Leaf, "n m"]


class Options(BaseModel):
    """The model alone has no options."""

    model_config = ConfigDict(extra="forbid")


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Float[Array, " n"]:
    """Start from xhat(0)."""
    return xhat0


def snapshot(gains: Gains, memory: Float[Array, " n"], now: Now) -> Float[Array, "0"]:
    """Return nothing: no sample is used."""
    return jnp.zeros(0)


def jump(gains: Gains, memory: Float[Array, " n"], now: Now, arrival: Arrival) -> Float[Array, " n"]:
    """Ignore what arrives."""
    return memory


def flow(gains: Gains, memory: Float[Array, " n"], now: Now) -> Float[Array, " n"]:
    """Move by one tick under the held input."""
    return gains.Phi @ memory + gains.Gamma @ now.u


def estimate(gains: Gains, memory: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the present xhat."""
    return memory


def field(gains: Gains, memory: Float[Array, " n"], now: Now, y: Float[Array, " q"]) -> Float[Array, " n"]:
    """Return dxhat/dt; of a continuous plant only."""
    return gains.A @ memory + gains.B @ now.u


OBSERVER = Observer(init, snapshot, jump, flow, estimate, field)


def design(context: DesignContext, options: Options) -> Design:
    """Discretise the model exactly; there is no gain to prove."""
    Phi, Gamma = linear.one_tick(context.model, context.dt)
    gains = Gains(Phi, Gamma, context.model.A, context.model.B)
    return Design(gains, Certificate(NO_GAIN, float("inf"), "none", "not needed", {"Phi": Phi}))
