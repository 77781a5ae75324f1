"""Any linear plant: x' = A x + B v, or x one tick later = A x + B v where `discrete`; y = C x + D v, v = gain u + bias.

A, B, C, D are the user's and what the observers know; `input_gain` and `input_bias` are how the plant differs from that.
The output of tick k sees the input held from t_k on. A tick is the exact exponential under that held input.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench.synthesis.linear import Model, one_tick
from pcbench.types import Leaf, Now, Plant


class Numbers(NamedTuple):
    """The plant; `plant.input_gain` and `plant.input_bias` are axes."""

    A: Any = ((0.0,),)  # [n, n]
    B: Any = ((1.0,),)  # [n, m]
    C: Any = ((1.0,),)  # [q, n]
    D: Any = None  # [q, m]; None: zero
    discrete: bool = False
    input_gain: float = 1.0
    input_bias: float = 0.0  # unit of the input
    drift: float = 0.0  # nothing drifts here
    drift_sign: float = 1.0


class Params(NamedTuple):
    """One tick and the output; n states, m inputs, q outputs."""

    Phi: Leaf  # [n, n]
    Gamma: Leaf  # [n, m]
    A: Leaf  # [n, n] of the field
    B: Leaf  # [n, m]
    C: Leaf  # [q, n]
    D: Leaf  # [q, m]
    gain: Leaf
    bias: Leaf


def nominal(numbers: Numbers) -> Model:
    """Return the model that observers know."""
    A, B, C = (np.array(M, float) for M in (numbers.A, numbers.B, numbers.C))
    return Model(A, B, C, None if numbers.D is None else np.array(numbers.D, float), numbers.discrete)


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of one tick of `dt` seconds."""
    model = nominal(numbers)
    Phi, Gamma = one_tick(model, dt)
    gain, bias = np.asarray(numbers.input_gain), np.asarray(numbers.input_bias)
    return Params(Phi, Gamma, model.A, model.B, model.C, model.feedthrough, gain, bias)


def step(params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Advance x by one tick under the held now.u."""
    return params.Phi @ x + params.Gamma @ (params.gain * now.u + params.bias)


def output(params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " q"]:
    """Return what is measured."""
    return params.C @ x + params.D @ (params.gain * now.u + params.bias)


def field(params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return dx/dt under the held now.u; of a continuous plant only."""
    return jnp.asarray(params.A) @ x + params.B @ (params.gain * now.u + params.bias)


PLANT = Plant(step, output, field)
