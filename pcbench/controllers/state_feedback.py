"""state-feedback: state feedback of the estimate about a set point, with held commands.

    c = offset + u_ref - K (xhat - x_ref), clipped to +-limit, every `period`

x_ref and u_ref are the state and input of the set points (`parts.set_points`). With `knows_delay` the law uses the state
predicted to the time at which its command acts, under the inputs in transit, and the set point of that time:

    xhat(t + d) = Phi^d xhat(t) + sum_i Phi^(d-1-i) Gamma u(t + i),  i = 0 .. d - 1

d is the mean delay to the plant in ticks. The loop is closed at t = 0; before, commands are 0. If an estimate contains
unknown inputs or parameters, the law uses the states only.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float
from pydantic import Field

from pcbench.controllers.parts import common
from pcbench.controllers.parts.common import ControllerContext, Rows, Sizes
from pcbench.controllers.parts.set_points import reference
from pcbench.protocols import Controller, Leaf, Now
from pcbench.synthesis import lqr


class Options(common.Options):
    """The gain, and the options of all laws."""

    K: Rows = Field(description="[m, n] gain")
    knows_delay: bool = Field(False, strict=True, description="use the state predicted to the arrival of the command")


class Params(NamedTuple):
    """Parameters: n states, m inputs, T ticks from 0 on."""

    K: Leaf  # [m, n]
    x_ref: Leaf  # [T, n]
    u_ref: Leaf  # [T, m], with the offset
    period_ticks: Leaf  # [ticks] between decisions
    limit: Leaf  # [m]
    late: Leaf  # [ticks] predicted
    Phi: Leaf  # [n, n] of a tick
    Gamma: Leaf  # [n, m]


def check(options: Options, sizes: Sizes) -> None:
    """Raise UserError if the options do not fit the plant."""
    common.matrix(options.K, (sizes.m, sizes.n), "K", sizes)
    common.require_common(options, sizes)


def prepare(options: Options, context: ControllerContext) -> Params:
    """Return the parameters of the law."""
    return numbers(options, context, np.array(options.K, float))


def numbers(options: Any, context: ControllerContext, K: np.ndarray) -> Params:
    """Return the parameters of a law with the gain K, for options that include those of all laws."""
    Phi, Gamma = context.tick
    aims = reference(options.set_point, context.states, (Phi, Gamma), context.dt, context.ticks + 1 + context.lookahead)
    m = Gamma.shape[1]
    limit = np.inf if options.limit is None else np.asarray(options.limit, float)
    return Params(
        K=K,
        x_ref=aims.x,
        u_ref=aims.u + np.asarray(options.offset, float),
        period_ticks=np.asarray(context.period_ticks(options.period)),
        limit=np.broadcast_to(limit, m).copy(),
        late=np.asarray(context.late if options.knows_delay else 0),
        Phi=Phi,
        Gamma=Gamma,
    )


def linear(options: Options, context: ControllerContext) -> lqr.Law:
    """Return the law linearised about its set point."""
    return of_gain(np.array(options.K, float))


def of_gain(K: np.ndarray) -> lqr.Law:
    """Return state feedback as a linear law without memory."""
    m, n = K.shape
    return lqr.Law(np.zeros((0, 0)), np.zeros((0, n)), np.zeros((m, 0)), -K)


def target(params: Params, tick: Array) -> Float[Leaf, " n"]:
    """Return x_ref at a tick."""
    return params.x_ref[tick]


def before(params: Params, tick: Array, estimate: Array) -> Float[Array, " m"]:
    """Return the command of a tick below 0: zero."""
    return jnp.zeros(params.K.shape[0])


def start(params: Params, estimate: Array) -> Float[Array, " m"]:
    """Return the last command before tick 0: zero."""
    return jnp.zeros(params.K.shape[0])


def now_at(
    params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array], last: Float[Array, " m"]
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Return the present command twice: as the command, and as the memory until the next decision."""
    return feedback_command(params, now, estimate[: params.K.shape[1]], now.tick, last)


def predictive_command(
    params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array], last: Float[Array, " m"]
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Return the present command twice, from the state predicted to the time at which it acts."""

    def step(i: Array, x: Array) -> Array:
        return params.Phi @ x + params.Gamma @ coming(i)

    x = lax.fori_loop(0, params.late, step, estimate[: params.K.shape[1]])
    return feedback_command(params, now, x, now.tick + params.late, last)


def feedback_command(
    params: Params, now: Now, x: Float[Array, " n"], row: Array, last: Float[Array, " m"]
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Return the command for x and the set point of tick `row`, or the last one between decisions; twice."""
    u = params.u_ref[row] - params.K @ (x - params.x_ref[row])
    u = jnp.where(now.tick % params.period_ticks == 0, jnp.clip(u, -params.limit, params.limit), last)
    return u, u


PLAIN = Controller(target, before, now_at, start)
PREDICTIVE = Controller(target, before, predictive_command, start)


def controller(options: Any) -> Controller:
    """Return the control law for the options."""
    return PREDICTIVE if options.knows_delay else PLAIN
