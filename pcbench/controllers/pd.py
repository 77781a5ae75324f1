"""pd: PD control of two angles from the estimate, optionally with `feedforward` and `predictor`.

    u_cmd = clip(-Kp (z1 - Td) - Kd (z2 - Td') [+ u_ff], +-limit)                                   (46), (47)

z1, z2 are the present estimates of angles and rates, and Td is the path. The command of time t acts at sigma with sigma -
tau(sigma) = t.

* feedforward: u_ff are the voltages with which the plant, with the present estimates of the viscosities, follows the path at
  sigma.
* predictor: the law uses the state predicted to sigma and Td(sigma) instead of z and Td(t). The prediction has Runge-Kutta
  steps of the model from the estimate, under the inputs of all commands so far. If it needs the command that is being
  computed, it uses the preceding one. The last step ends at sigma.

Commands before t = 0 are the same law at the estimate of t = 0, without prediction. The path is an array with one row per
tick.
Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, section 4.1; the options are this project's. The paper has no
gravity term.
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
    """Gains, limits, path, feedforward and prediction."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    Kp: tuple[float, float]
    Kd: tuple[float, float]
    limit: tuple[float, float] = Field(description="largest command [V]")
    path: str = Field(description="name of the path")
    feedforward: bool = False
    predictor: bool = False


class Params(NamedTuple):
    """Parameters for T ticks from `first` on."""

    Kp: Leaf  # [2]
    Kd: Leaf  # [2]
    limit: Leaf  # [2]
    help: Leaf  # 1: with feedforward, 0: without
    first: Leaf  # the tick of row 0, below 0
    path: Leaf  # [T, 3, 2] Td, Td', Td'' at t
    goal: Leaf  # [T, 3, 2] at sigma
    lead: Leaf  # [T] sigma - t [s]
    model: Callable[..., Array]  # (now, x[4], B[2]) -> dx/dt[4] of the nominal plant
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
    """Return the parameters of the law for ticks -`rows` .. `ticks`."""
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
        lead=sigma - t,
        model=model,
        inverse=inverse,
    )


def law(params: Params, row: Array, x: Array, B: Array, aim: Float[Leaf, "3 2"]) -> Float[Array, "2"]:
    """Return the clipped command for angles and rates x [4] with the set point `aim` and viscosities B [2]."""
    u = -params.Kp * (x[:2] - aim[0]) - params.Kd * (x[2:4] - aim[1])
    return jnp.clip(u + params.help * params.inverse(B, *params.goal[row]), -params.limit, params.limit)


def before(predicts: bool, params: Params, tick: Array, estimate: Array) -> Float[Array, "2"]:
    """Return the command of a tick below 0."""
    row = tick - params.first
    return law(params, row, estimate[:4], estimate[4:], (params.goal if predicts else params.path)[row])


def now_at(params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array]) -> Float[Array, "2"]:
    """Return the present command, from the present estimate."""
    row = now.tick - params.first
    return law(params, row, estimate[:4], estimate[4:], params.path[row])


def pd_command(params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array]) -> Float[Array, "2"]:
    """Return the present command, from the state predicted to the time at which it acts."""
    row, B = now.tick - params.first, estimate[4:]
    horizon = params.lead[row]

    def step(i: Array, x: Array) -> Array:
        future = now._replace(u=coming(i))
        return rk4(lambda t, x: params.model(future, x, B), now.t, x, jnp.minimum(now.dt, horizon - i * now.dt))

    steps = jnp.ceil(horizon / now.dt - 1e-6).astype(int)
    x = lax.fori_loop(0, steps, step, estimate[:4])
    return law(params, row, x, B, params.goal[row])


def target(params: Params, tick: Array) -> Float[Leaf, "2"]:
    """Return Td at a tick [rad]."""
    return params.path[tick - params.first, 0]


PD = Controller(target, partial(before, False), now_at)
PREDICTIVE = Controller(target, partial(before, True), pd_command)


def controller(options: Options) -> Controller:
    """Return the control law for the options."""
    return PREDICTIVE if options.predictor else PD
