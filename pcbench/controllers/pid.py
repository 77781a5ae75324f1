"""pid: PID control of the estimated outputs, in discrete time with period T, with held commands.

    e = C (x_ref - xhat),  y = C xhat
    I+ = I + Ki T e                                         (for each input, only while its command is within the limit)
    D+ = f D + (1 - f) (y - y_last) / T,  f = filter / (filter + T)
    c = offset + Kp e + I+ - Kd D+, clipped to +-limit

The derivative is that of the output, not of the set point, so that a step of the set point causes no peak. I and D start at
0, and y_last at the estimate of t = 0. Before t = 0 commands are 0.
Source: Astrom, Hagglund, Advanced PID Control, 3 and 13; backward differences.
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from pydantic import Field, Strict

from pcbench.controllers.parts import common
from pcbench.controllers.parts.common import ControllerContext, Number, Rows, Sizes
from pcbench.controllers.parts.set_points import reference
from pcbench.protocols import Controller, Leaf, Now
from pcbench.synthesis import lqr

Gain = Number | list[Number] | Rows


class Options(common.Options):
    """Gains [m, q] from output errors to inputs; a number or a list if there are as many inputs as outputs."""

    Kp: Gain = Field(description="[m, q] proportional gain")
    Ki: Gain = Field(0.0, description="[m, q] integral gain [1/s]")
    Kd: Gain = Field(0.0, description="[m, q] derivative gain [s]")
    filter: Annotated[float, Strict()] = Field(
        0.0, ge=0, description="time constant of the filter of the derivative [s]"
    )


class Params(NamedTuple):
    """Parameters: n states, m inputs, q outputs, T ticks from 0 on."""

    C: Leaf  # [q, n]
    Kp: Leaf  # [m, q]
    KiT: Leaf  # [m, q] Ki T
    Kd: Leaf  # [m, q]
    T: Leaf  # [s]
    filter: Leaf  # f
    x_ref: Leaf  # [T, n]
    offset: Leaf  # [m]
    period_ticks: Leaf  # [ticks]
    limit: Leaf  # [m]


class PidState(NamedTuple):
    """Memory of the law between decisions."""

    u: Float[Array, " m"]
    integral: Float[Array, " m"]
    y: Float[Array, " q"]
    slope: Float[Array, " q"]


def check(options: Options, sizes: Sizes) -> None:
    """Raise UserError if the options do not fit the plant."""
    for name in ("Kp", "Ki", "Kd"):
        if name == "Kp" or getattr(options, name) != 0.0:
            common.matrix(getattr(options, name), (sizes.m, sizes.q), name, sizes)
    common.require_common(options, sizes)


def prepare(options: Options, context: ControllerContext) -> Params:
    """Return the parameters of the law."""
    (q, _), (_, m) = context.model.C.shape, context.model.B.shape
    sizes, period = Sizes(context.states, m, q, context.dt, "controller"), context.period_ticks(options.period)
    T = period * context.dt
    Kp, Ki, Kd = (
        np.zeros((m, q)) if gain == 0.0 else common.matrix(gain, (m, q), "gain", sizes)
        for gain in (options.Kp, options.Ki, options.Kd)
    )
    limit = np.inf if options.limit is None else np.asarray(options.limit, float)
    return Params(
        C=context.model.C,
        Kp=Kp,
        KiT=Ki * T,
        Kd=Kd,
        T=np.asarray(T),
        filter=np.asarray(options.filter / (options.filter + T)),
        x_ref=reference(
            options.set_point, context.states, context.tick, context.dt, context.ticks + 1 + context.lookahead
        ).x,
        offset=np.broadcast_to(np.asarray(options.offset, float), m).copy(),
        period_ticks=np.asarray(period),
        limit=np.broadcast_to(limit, m).copy(),
    )


def linear(options: Options, context: ControllerContext) -> lqr.Law:
    """Return the law of the state, linearised about its set point; its memory is (I, y_last, D)."""
    p = prepare(options, context)
    q, m, f = len(p.C), len(p.Kp), float(p.filter)
    rate = (1 - f) / float(p.T)
    A = np.zeros((m + 2 * q, m + 2 * q))
    A[:m, :m] = np.diag(1.0 * p.KiT.any(1))  # 0 without integral gain
    A[m + q :, m : m + q], A[m + q :, m + q :] = -rate * np.eye(q), f * np.eye(q)
    B = np.vstack([-p.KiT @ p.C, p.C, rate * p.C])
    out = np.hstack([np.eye(m), np.zeros((m, q)), -p.Kd])  # the command uses the updated I and D
    return lqr.Law(A, B, out @ A, out @ B - p.Kp @ p.C)


def target(params: Params, tick: Array) -> Float[Leaf, " n"]:
    """Return x_ref at a tick."""
    return params.x_ref[tick]


def before(params: Params, tick: Array, estimate: Array) -> Float[Array, " m"]:
    """Return the command of a tick below 0: zero."""
    return jnp.zeros(params.Kp.shape[0])


def start(params: Params, estimate: Array) -> PidState:
    """Return the memory before tick 0."""
    m, (q, n) = params.Kp.shape[0], params.C.shape
    return PidState(jnp.zeros(m), jnp.zeros(m), params.C @ estimate[:n], jnp.zeros(q))


def command(
    params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array], memory: PidState
) -> tuple[Float[Array, " m"], PidState]:
    """Return the present command and the new memory."""
    y = params.C @ estimate[: params.C.shape[1]]
    e = params.C @ params.x_ref[now.tick] - y
    slope = params.filter * memory.slope + (1 - params.filter) * (y - memory.y) / params.T
    integral = memory.integral + params.KiT @ e
    u_law = params.offset + params.Kp @ e + integral - params.Kd @ slope
    u = jnp.clip(u_law, -params.limit, params.limit)
    new, decides = (
        PidState(u, jnp.where(u == u_law, integral, memory.integral), y, slope),
        now.tick % params.period_ticks == 0,
    )
    after = PidState(*(jnp.where(decides, a, b) for a, b in zip(new, memory, strict=True)))
    return after.u, after


PID = Controller(target, before, command, start)


def controller(options: common.Options) -> Controller:
    """Return the law."""
    return PID
