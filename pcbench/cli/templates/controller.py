"""NAME: your own controller, in one file.

    pcbench check NAME.py:NAME                                   check that it follows the protocol, and that the loop is stable
    pcbench run cart/white --set controller.use=NAME.py:NAME     close the loop with it, once per observer

In a study file it is a table: [controller] use = "NAME.py:NAME", with its options, actuator_delay and others.
A controller is a few pure functions of its numbers (`params`). Write them in jax.numpy for one run. n states, m inputs.

    prepare   computes its numbers, in NumPy, once per grid point
    start     returns its memory before the first tick; leave it out if the controller has no memory
    command   returns the command u [m] from the present estimate, and the new memory
    before    returns the command of a tick before 0, for a loop that ran already
    target    returns the set point of the first r states; the tables show the tracking error

This controller leads the first state to `aim`: state feedback with an integrator, designed as LQR.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import BaseModel, Field
from scipy.linalg import solve_discrete_are

import pcbench


class Options(BaseModel):
    """Options that a study can set: [controller] use = "NAME.py:NAME", aim = 0.5."""

    aim: float = Field(0.5, description="set point of the first state")
    weight: float = Field(1.0, gt=0, description="weight of the command: larger is gentler")
    period: float | None = Field(None, gt=0, description="period of the controller [s]; default: one tick")
    limit: float = Field(10.0, gt=0, description="largest command")


class Params(NamedTuple):
    """All numbers of the controller: nothing else may differ between grid points."""

    K: Any  # [m, n] gain of the state
    Ki: Any  # [m] gain of the integral
    aim: Any
    limit: Any
    T: Any  # period [s]
    period_ticks: Any  # period in ticks


def prepare(options: Options, context: pcbench.ControllerContext) -> Params:
    """Compute the numbers. `context` has the linear model, dt [s], names of the states, `late` (delay of commands in ticks)."""
    period_ticks, (Phi, Gamma) = context.period_ticks(options.period), context.tick  # one tick: x -> Phi x + Gamma u
    n, m = Gamma.shape
    A, B = np.eye(n + 1), np.zeros((n + 1, m))
    tick = np.block(
        [[Phi, np.zeros((n, 1))], [-context.dt * np.eye(1, n), np.ones((1, 1))]]
    )  # the integral is an additional state
    for _ in range(period_ticks):  # the input is held over the period
        A, B = tick @ A, tick @ B + np.vstack([Gamma, np.zeros((1, m))])
    S = solve_discrete_are(A, B, np.eye(n + 1), options.weight * np.eye(m))
    K = np.linalg.solve(options.weight * np.eye(m) + B.T @ S @ B, B.T @ S @ A)
    numbers = options.aim, options.limit, period_ticks * context.dt, period_ticks
    return Params(K[:, :n], K[:, n], *(np.asarray(v) for v in numbers))


def target(params: Params, tick: Array) -> Array:
    """Return the set point at a tick."""
    return params.aim[None]


def before(params: Params, tick: Array, estimate: Array) -> Array:
    """Return the command of a tick before 0, here 0."""
    return jnp.zeros(len(params.K))


def start(params: Params, estimate: Array) -> Any:
    """Return the memory before tick 0: the last command, and the integral of the first state's error."""
    return jnp.zeros(len(params.K)), jnp.zeros(())


def command(params: Params, now: pcbench.Now, estimate: Array, coming: Any, kept: Any) -> tuple[Array, Any]:
    """Return the command and the new memory. coming(i) is the input that acts in i ticks, if it is computed already."""
    x = estimate[: params.K.shape[1]]  # estimated unknown inputs follow the states
    off = x.at[0].add(-params.aim)
    integral = kept[1] - params.T * off[0]
    free = -params.K @ off - params.Ki * integral
    u = jnp.clip(free, -params.limit, params.limit)
    new = u, jnp.where(jnp.all(u == free), integral, kept[1])  # no windup at the limit
    decides = now.tick % params.period_ticks == 0  # the command is held over the period
    after = jax.tree.map(lambda a, b: jnp.where(decides, a, b), new, kept)
    return after[0], after


NAME = pcbench.Controller(target, before, command, start)
