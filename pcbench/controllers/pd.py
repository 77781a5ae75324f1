"""PD control of two angles from the estimate, with its options `feedforward` and `predictor`.

    u_cmd = clip(-Kp (z1 - Td) - Kd (z2 - Td') [+ u_ff], +-limit)                                   (46), (47)

z1, z2 are the estimated angles and rates of now, Td the path. A command of time t acts at sigma with sigma - tau(sigma) = t.

* feedforward: u_ff are the voltages under which the plant, with the viscosities estimated now, moves along the path at sigma.
* predictor: the PD law takes the state predicted to sigma and Td(sigma) in place of z and Td(t): Runge-Kutta steps of the model
  from the estimate, under the inputs that the commands given so far become; what would need the command now sought takes the
  one before it. The last step ends at sigma.

Commands of the time before 0 are the same law at the estimate of t = 0, without prediction. The path is data, a row a tick.
Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, section 4.1; the options are ours. The paper has no gravity term.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from pcbench.dynamics.integrate import rk4
from pcbench.protocols import Controller, Delay, Leaf, Now
from pcbench.scenarios.signals import PATHS


class Options(BaseModel):
    """Gains, limits and what the law is helped by."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    Kp: tuple[float, float]
    Kd: tuple[float, float]
    limit: tuple[float, float] = Field(description="largest command [V]")
    path: str = Field(description="name of the path")
    feedforward: bool = False
    predictor: bool = False


class Params(NamedTuple):
    """T ticks from `first` on."""

    Kp: Leaf  # [2]
    Kd: Leaf  # [2]
    limit: Leaf  # [2]
    help: Leaf  # 1: with feedforward, 0: without
    first: Leaf  # the tick of row 0, below 0
    path: Leaf  # [T, 3, 2] Td, Td', Td'' at t
    goal: Leaf  # [T, 3, 2] at sigma
    ahead: Leaf  # [T] sigma - t [s]
    model: Callable[..., Array]  # (now, x[4], B[2]) -> dx/dt[4], as observers know it
    inverse: Callable[..., Array]  # (B[2], Td[2], Td'[2], Td''[2]) -> u[2]


def acts_at(t: np.ndarray, delay: Delay) -> np.ndarray:
    """Return sigma with sigma - delay(sigma) = t [s], for a delay that changes by less than 1 s/s."""
    sigma = t + delay(t)
    for _ in range(200):
        sigma, last = t + delay(sigma), sigma
        if np.array_equal(sigma, last):
            break
    return sigma


def prepare(options: Options, delay: Delay, dt: float, rows: int, ticks: int, model: Any, inverse: Any) -> Params:
    """Return the law's numbers for ticks -`rows` .. `ticks`."""
    t = dt * np.arange(-rows, ticks + 1, dtype=np.float64)
    sigma, path = acts_at(t, delay), PATHS[options.path]
    return Params(
        Kp=np.array(options.Kp),
        Kd=np.array(options.Kd),
        limit=np.array(options.limit),
        help=np.array(float(options.feedforward)),
        first=np.array(-rows),
        path=path(t),
        goal=path(sigma),
        ahead=sigma - t,
        model=model,
        inverse=inverse,
    )


def law(params: Params, row: Array, x: Array, B: Array, aim: Float[Leaf, "3 2"]) -> Float[Array, "2"]:
    """Return the clipped command of angles and rates x [4] against `aim`, with viscosities B [2]."""
    u = -params.Kp * (x[:2] - aim[0]) - params.Kd * (x[2:4] - aim[1])
    return jnp.clip(u + params.help * params.inverse(B, *params.goal[row]), -params.limit, params.limit)


def before(predicts: bool, params: Params, tick: Array, estimate: Array) -> Float[Array, "2"]:
    """Return the command of a tick below 0."""
    row = tick - params.first
    return law(params, row, estimate[:4], estimate[4:], (params.goal if predicts else params.path)[row])


def now_at(params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array]) -> Float[Array, "2"]:
    """Return the command of now, from the estimate of now."""
    row = now.tick - params.first
    return law(params, row, estimate[:4], estimate[4:], params.path[row])


def pd_command(params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array]) -> Float[Array, "2"]:
    """Return the command of now, from the state predicted to the time at which it acts."""
    row, B = now.tick - params.first, estimate[4:]
    left = params.ahead[row]

    def step(i: Array, x: Array) -> Array:
        there = now._replace(u=coming(i))
        return rk4(lambda t, x: params.model(there, x, B), now.t, x, jnp.minimum(now.dt, left - i * now.dt))

    steps = jnp.ceil(left / now.dt - 1e-6).astype(int)
    x = lax.fori_loop(0, steps, step, estimate[:4])
    return law(params, row, x, B, params.goal[row])


def target(params: Params, tick: Array) -> Float[Leaf, "2"]:
    """Return Td at a tick [rad]."""
    return params.path[tick - params.first, 0]


PD = Controller(target, partial(before, False), now_at)
PREDICTIVE = Controller(target, partial(before, True), pd_command)


def controller(options: Options) -> Controller:
    """Return the law that the options ask for."""
    return PREDICTIVE if options.predictor else PD
