"""NAME: a controller of your own, in one file.

    pcbench check NAME.py:NAME                                   does it keep to the protocol, does the loop settle?
    pcbench run cart/white --set controller.use=NAME.py:NAME     the loop closed by it, once for each observer

In a study file it is a table: [controller] use = "NAME.py:NAME", its options beside it, and actuator_delay and the like.
It is a few pure functions of its numbers (`params`), written in jax.numpy for one run. n states, m inputs.

    prepare   find its numbers, in NumPy, once for each cell
    start     what it keeps from tick to tick, before the first; leave it out where it keeps nothing
    command   what it asks of the plant now, u [m], from the estimate of now, and what it keeps
    before    the command of a time before 0, when commands were already on their way
    target    the set point of the first r states: tables say how far the plant is off it

This one leads the first state to `aim`: state feedback with an integrator, least squares of error and command (LQR).
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
    """What a study may set: [controller] use = "NAME.py:NAME", aim = 0.5."""

    aim: float = Field(0.5, description="set point of the first state")
    weight: float = Field(1.0, gt=0, description="of the command: larger is gentler")
    period: float | None = Field(None, gt=0, description="between decisions [s]; default: every tick")
    limit: float = Field(10.0, gt=0, description="largest command")


class Params(NamedTuple):
    """Every number it uses: nothing else may change from cell to cell."""

    K: Any  # [m, n] of the state
    Ki: Any  # [m] of the integral
    aim: Any
    limit: Any
    T: Any  # s between decisions
    every: Any  # the same in ticks


def prepare(options: Options, context: pcbench.ControllerContext) -> Params:
    """Find the numbers. `context` has the linear model, dt [s], the names of the states, `late` (ticks to the plant)."""
    every, (Phi, Gamma) = context.every(options.period), context.tick  # one tick: x -> Phi x + Gamma u
    n, m = Gamma.shape
    A, B = np.eye(n + 1), np.zeros((n + 1, m))
    tick = np.block(
        [[Phi, np.zeros((n, 1))], [-context.dt * np.eye(1, n), np.ones((1, 1))]]
    )  # the integral is a state too
    for _ in range(every):  # the input is held from decision to decision
        A, B = tick @ A, tick @ B + np.vstack([Gamma, np.zeros((1, m))])
    S = solve_discrete_are(A, B, np.eye(n + 1), options.weight * np.eye(m))
    K = np.linalg.solve(options.weight * np.eye(m) + B.T @ S @ B, B.T @ S @ A)
    numbers = options.aim, options.limit, every * context.dt, every
    return Params(K[:, :n], K[:, n], *(np.asarray(v) for v in numbers))


def target(params: Params, tick: Array) -> Array:
    """Return the set point at a tick."""
    return params.aim[None]


def before(params: Params, tick: Array, estimate: Array) -> Array:
    """Return the command of a tick below 0: none."""
    return jnp.zeros(len(params.K))


def start(params: Params, estimate: Array) -> Any:
    """Return what is kept before tick 0: the last command, and the integral of the first state's error."""
    return jnp.zeros(len(params.K)), jnp.zeros(())


def command(params: Params, now: pcbench.Now, estimate: Array, coming: Any, kept: Any) -> tuple[Array, Any]:
    """Return the command, and what is kept. coming(i) is the input that acts i ticks on, as far as it is decided."""
    x = estimate[: params.K.shape[1]]  # an observer may estimate unknown inputs too: they stand behind the states
    off = x.at[0].add(-params.aim)
    integral = kept[1] - params.T * off[0]
    free = -params.K @ off - params.Ki * integral
    u = jnp.clip(free, -params.limit, params.limit)
    new = u, jnp.where(jnp.all(u == free), integral, kept[1])  # at its limit it does not wind up
    decides = now.tick % params.every == 0  # between decisions the command is held
    after = jax.tree.map(lambda a, b: jnp.where(decides, a, b), new, kept)
    return after[0], after


NAME = pcbench.Controller(target, before, command, start)
