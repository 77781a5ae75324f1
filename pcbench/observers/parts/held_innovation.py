"""Shared parts of observers that use an innovation until the next one arrives, held or with a predictor.

    xhat' = f(xhat, u) + L g,    g = c - al,    al' = W g,    c = y_k - (C xhat(t_k) - al(t_k))

t_k is the time of the newest sample of each output. With W = 0, al stays 0 and g is the held innovation. With W = C L, g is w
- C xhat with an output predictor w' = C f(xhat, u), w(t_k) = y_k, because (C xhat - al)' = C f.
A tick of a linear model is its exact map for held u and c, and of a nonlinear field one Runge-Kutta step. A sample older than
the one in use is dropped.
Time index: xhat is the estimate of the present, after the jump.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError
from pcbench.observers.parts.common import known_input, xhat
from pcbench.protocols import Arrival, Leaf, Now, Observer
from pcbench.synthesis.certificate import DesignContext


class Gains(NamedTuple):
    """n states, m inputs, q outputs, s unknowns."""

    Phi: Float[Leaf, "k k"]  # of (xhat, al) over one tick, k = n + q
    Gamma: Float[Leaf, "k l"]  # of (u, c) over one tick, l = m + q
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    L: Float[Leaf, "n q"]
    W: Float[Leaf, "q q"]
    unknowns: Float[Leaf, " s"]  # assumed constant
    field: Any  # (now, x[n], p[s]) -> dx/dt[n]; None: the model is linear


class Memory(NamedTuple):
    """The memory between ticks."""

    xhat: Float[Array, " n"]
    al: Float[Array, " q"]
    c: Float[Array, " q"]
    newest: Int[Array, " q"]  # index of the sample that c is of; -1: none


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0), with innovation 0."""
    q = gains.C.shape[0]
    return Memory(xhat0, jnp.zeros(q), jnp.zeros(q), jnp.full(q, -1, int))


def snapshot(gains: Gains, memory: Memory, now: Now) -> Float[Array, " q"]:
    """Return C xhat - al."""
    return gains.C @ memory.xhat - memory.al


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Compute c of each arriving output, unless a newer sample of it is in use."""
    newer = arrival.mask & (arrival.index > memory.newest)
    c = arrival.value - known_input(gains.D, now, arrival.age) - arrival.snapshot
    return memory._replace(c=jnp.where(newer, c, memory.c), newest=jnp.where(newer, arrival.index, memory.newest))


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Advance by one tick, with u and c held."""
    n = memory.xhat.shape[0]
    if gains.field is None:
        joint = jnp.concatenate([memory.xhat, memory.al])
        joint = gains.Phi @ joint + gains.Gamma @ jnp.concatenate([now.u, memory.c])
        return memory._replace(xhat=joint[:n], al=joint[n:])

    def rate(t: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        g = memory.c - state[1]
        return gains.field(now._replace(t=t), state[0], gains.unknowns) + gains.L @ g, gains.W @ g

    xhat, al = rk4(rate, now.t, (memory.xhat, memory.al), now.dt)
    return memory._replace(xhat=xhat, al=al)


OBSERVER = Observer(init, snapshot, jump, flow, xhat)


def require_continuous(context: DesignContext, where: str) -> None:
    """Raise UserError unless the plant is continuous and its outputs are linear in the state."""
    if context.model.discrete or context.successor or context.sensor or context.residual:
        raise UserError(
            f"{where}: got a plant in discrete time or with a nonlinear output, expected a continuous plant with outputs "
            "that are linear in the state; use kf or ekf."
        )


def gains_of(context: DesignContext, L: Matrix, W: Matrix) -> Gains:
    """Return the gains for L [n, q] and W [q, q]."""
    model, (n, q) = context.model, L.shape
    m = model.B.shape[1]
    A = np.block([[model.A, -L], [np.zeros((q, n)), -W]])
    B = np.block([[model.B, L], [np.zeros((q, m)), W]])
    Phi, Gamma = linear.discretize_zoh(A, B, context.dt)
    return Gains(
        Phi=Phi,
        Gamma=Gamma,
        C=model.C,
        D=model.feedthrough,
        L=L,
        W=W,
        unknowns=np.array(context.unknown0, float),
        field=context.field,
    )
