"""The mobile cart: x = [position m, velocity m/s], y = position.

    x' = [0 1; 0 -lam] x + [0; b] u,   lam = 122 1/s, b = 355                               (30)

With drift (section 6.3): A22(t) = -120 - (4 sin 10t + 20 cos t sin t), B21(t) = 355 + 24 cos 2t + s 20 sin 2t cos 2t. The
operator between the last two terms is missing in print: s is +1 here, or `plant.drift_sign`. `drift` scales the deviation from
the nominal numbers: 0 nominal, 1 as printed. Observers assume the nominal parameters.

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017), sections 6 and 6.3.
Without drift a tick is the exact exponential. With drift the parameters vary within the tick and only u is held; the
tick's linear map is integrated by Runge-Kutta once and shared by all runs.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.dynamics.integrate import transition
from pcbench.dynamics.linear import Model, discretize_zoh
from pcbench.protocols import Leaf, Now, Plant

SIGNALS = (("position", "m"), ("velocity", "m/s"))
SUBSTEPS = 4  # of Runge-Kutta per tick under drift


class Numbers(NamedTuple):
    """The cart's parameters; `plant.lam`, `plant.b` and `plant.drift_sign` are axes."""

    lam: float = 122.0  # 1/s
    b: float = 355.0  # velocity gained per second and unit of input
    drift: float = 0.0  # scale of the printed drift
    drift_sign: float = 1.0  # s
    input_bias: float = 0.0  # unit of the input, added to the input of the plant


class Params(NamedTuple):
    """The linear map of every tick k = 0 .. N, x(t_k+1) = Phi[k] x(t_k) + Gamma[k] (u_k + bias); one row: constant."""

    Phi: Leaf  # [N+1 or 1, 2, 2]
    Gamma: Leaf  # [N+1 or 1, 2, 1]
    numbers: Numbers  # parameters of the field


def nominal(numbers: Numbers) -> Model:
    """Return the model for designs."""
    return Model(np.array([[0.0, 1.0], [0.0, -numbers.lam]]), np.array([[0.0], [numbers.b]]), np.array([[1.0, 0.0]]))


def coefficients(numbers: Numbers, t: Array) -> tuple[Array, Array]:
    """Return A22(t) and B21(t) at t [s]."""
    a22 = -120.0 - (4 * jnp.sin(10 * t) + 20 * jnp.cos(t) * jnp.sin(t))
    b21 = 355.0 + 24 * jnp.cos(2 * t) + numbers.drift_sign * 20 * jnp.sin(2 * t) * jnp.cos(2 * t)
    return -numbers.lam + numbers.drift * (a22 + 122.0), numbers.b + numbers.drift * (b21 - 355.0)


def field(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "2"]:
    """Return dx/dt at the stage's time now.t under the held now.u."""
    a22, b21 = coefficients(params.numbers, now.t)
    return jnp.stack([x[1], a22 * x[1] + b21 * (now.u[0] + params.numbers.input_bias)])


@partial(jax.jit, static_argnames="ticks")
def _drift_params(numbers: Numbers, dt: Array, ticks: int) -> Params:
    params = Params(
        jnp.zeros(0), jnp.zeros(0), numbers._replace(input_bias=0.0)
    )  # the bias is added to the input elsewhere

    def tick(k: Array) -> Array:  # state and held input as one linear system of size three
        def joint(t: Array, z: Array) -> Array:
            now = Now(t, k, dt, z[2:], lambda age: z[2:])
            return jnp.append(field(params, now, z[:2]), 0.0)

        return transition(joint, k * dt, 3, dt, SUBSTEPS)

    transitions = jax.vmap(tick)(jnp.arange(ticks + 1))
    return Params(transitions[:, :2, :2], transitions[:, :2, 2:], numbers)


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of every tick 0 .. `ticks` of `dt` seconds."""
    if numbers.drift:
        return _drift_params(jax.tree.map(jnp.asarray, numbers), jnp.asarray(dt), ticks)
    model = nominal(numbers)
    Phi, Gamma = discretize_zoh(model.A, model.B, dt)
    return Params(Phi[None], Gamma[None], numbers)


def step(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "2"]:
    """Advance x by one tick under the held now.u."""
    is_constant = params.Phi.shape[0] == 1
    Phi, Gamma = (params.Phi[0], params.Gamma[0]) if is_constant else (params.Phi[now.tick], params.Gamma[now.tick])
    return Phi @ x + Gamma @ (now.u + params.numbers.input_bias)


def output(params: Params, now: Now, x: Float[Array, "2"]) -> Float[Array, "1"]:
    """Return the measured position [m]."""
    return x[:1]


PLANT = Plant(step, output, field)
