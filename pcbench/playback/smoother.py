"""Fixed-interval smoother of a linear model: the best estimate at each tick from all samples of a recording.

It is a Kalman filter over ticks, with each sample used at the tick at which it was taken, and an adjoint backward pass:

    forward    x-, P- at each tick; channel by channel nu = y - c x - D u, s = c P c' + r, K = P c' / s
    backward   lambda <- lambda - c' (K' lambda + nu / s) over the channels, then A' lambda over a tick
    smoothed   x- - P- lambda

No covariance is inverted, so a model without process noise needs no special case. Noise and prior are those of the designs.
Source: Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973).
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import Float

from pcbench.dynamics import linear
from pcbench.protocols import Leaf
from pcbench.runtime import memory, program_cache
from pcbench.synthesis.certificate import DesignContext

MAX_NUMBERS = 1 << 26  # most numbers that are stored for a recording
COPIES = 1.5  # copies of them in memory at one time, including other arrays


class Linear(NamedTuple):
    """One tick of a linear model with its noise; n states, m inputs, q outputs."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    Q: Float[Leaf, "n n"]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    R: Float[Leaf, "*N q"]  # common to all samples, or one row per tick
    x0: Float[Leaf, " n"]
    P0: Float[Leaf, "n n"]


class Forward(NamedTuple):
    """The stored values of every tick."""

    x: Array  # [N, n] before its samples
    P: Array  # [N, n, n]
    K: Array  # [N, q, n]; 0 for a channel without a sample
    nu: Array  # [N, q]; 0 for a channel without a sample
    s: Array  # [N, q]; 1 for a channel without a sample


def model_of(context: DesignContext, xhat0: ArrayLike) -> Linear | None:
    """Return the model of a design context; None if it is not linear or has an unknown input."""
    if context.field or context.successor or context.model.E is not None or context.unknown_std:
        return None
    Phi, Gamma = linear.one_tick(context.model, context.dt)
    Q = linear.input_noise(context.model, context.input_intensity, context.dt) + context.process_noise
    R, model = context.noise_variance, context.model
    return Linear(Phi, Gamma, Q, model.C, model.feedthrough, R=R, x0=np.asarray(xhat0, float), P0=context.P0)


def fits(model: Linear, ticks: int) -> bool:
    """Return whether there is enough memory to smooth this many ticks.

    Checked in advance, because a compiled program without memory may end the process.
    """
    q, n = model.C.shape
    numbers = ticks * (2 * n + n * n + q * (n + 3) + model.Gamma.shape[1])
    return numbers <= MAX_NUMBERS and COPIES * 8 * numbers <= memory.free()


def forward(model: Linear, u: Array, y: Array) -> Forward:
    """Return the forward pass over samples y [N, q] (NaN: none) at their sampling ticks, with inputs u [N, m]."""

    def step(carry: tuple[Array, Array], row: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], Forward]:
        (x, P), (u, y, R) = carry, row
        updates: list[tuple[Array, Array, Array]] = []
        for c, d, r, value in zip(model.C, model.D, R, y, strict=True):
            exists = ~jnp.isnan(value)
            s = c @ P @ c + r
            K = jnp.where(exists, P @ c / s, 0.0)
            nu = jnp.where(exists, value - c @ x - d @ u, 0.0)
            keep = jnp.eye(len(x)) - jnp.outer(K, c)
            x, P = x + K * nu, keep @ P @ keep.T + r * jnp.outer(K, K)
            updates.append((K, nu, jnp.where(exists, s, 1.0)))
        values = Forward(*carry, *(jnp.stack(rows) for rows in zip(*updates, strict=True)))
        return (model.Phi @ x + model.Gamma @ u, model.Phi @ P @ model.Phi.T + model.Q), values

    rows = (u, y, jnp.broadcast_to(model.R, y.shape))
    return lax.scan(step, (jnp.asarray(model.x0), jnp.asarray(model.P0)), rows)[1]


def smooth(model: Linear, u: Array, y: Array) -> Array:
    """Return the smoothed states [N, n] at every tick."""
    f = forward(model, u, y)

    def back(after: Array, row: Forward) -> tuple[Array, Array]:
        for j in reversed(range(len(model.C))):
            has_sample = jnp.any(row.K[j] != 0) | (row.nu[j] != 0)
            after = jnp.where(has_sample, after - model.C[j] * (row.K[j] @ after + row.nu[j] / row.s[j]), after)
        return model.Phi.T @ after, row.x - row.P @ after

    return lax.scan(back, jnp.zeros(len(model.Phi)), f, reverse=True)[1]


@cache
def jit_smoother() -> Callable[[Linear, ArrayLike, ArrayLike], Array]:
    """Return `smooth` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(smooth)
