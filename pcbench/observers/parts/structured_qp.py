"""Quadratic program along a chain of states, with bounds, by an interior-point method; each step is a smoother.

    min  |z_0 - m|^2_(P^-1) + sum_i |z_i - F_i z_(i-1) - b_i|^2_(Q_i^-1) + sum_ij w_ij (y_ij - h_ij' z_i)^2,  low <= z_i <= high

Without bounds, the solution is one forward pass of the Kalman filter and one backward pass of Bryson and Frazier's recursion.
It does not invert covariances, so P and Q_i may be 0.
With bounds, l, u are their multipliers and s, t the distances from them. A step adds to each entry of each state a
measurement of weight d = l / s + u / t at z + tau (1 / s - 1 / t) / d, with tau a tenth of the mean of l s and u t. This is
Newton's step on the optimality conditions, shortened so that all states stay within their bounds. The number of steps, STEPS,
is fixed.
Source: Bryson, Frazier 1963; Wright, Primal-Dual Interior-Point Methods, 1997, chapter 5.
Not claimed: a distinction between an active bound and one that is closer than 1e-8 of the prior's size.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, PyTree

from pcbench.observers.parts import kalman
from pcbench.protocols import Leaf

STEPS = 25  # steps of the interior-point method
CENTERING = 0.1  # target of l s relative to its mean
STEP_FRACTION = 0.99  # largest part of the distance to a bound in a step
INITIAL_PRODUCT, LEAST_PRODUCT = 1.0, 1e-14  # initial l s; least target of l s


class Chain(NamedTuple):
    """S states of N numbers with k measurements each; F and b of the first state are not used."""

    F: Float[Array, "S N N"]
    b: Float[Array, "S N"]
    Q: Float[Array, "S N N"]
    h: Float[Array, "S k N"]
    y: Float[Array, "S k"]
    w: Float[Array, "S k"]  # 1 / variance; 0: none


class Bounds(NamedTuple):
    """Bounds of every state; infinite: no bound."""

    low: Float[Leaf, " N"]
    high: Float[Leaf, " N"]
    size: Float[Leaf, " N"]  # initial distance from a bound, unless the bounds are closer


def smooth_chain(chain: Chain) -> Float[Array, "S N"]:
    """Return the most likely states, without bounds."""

    def forward(carry: tuple[Array, Array], stage: PyTree) -> tuple[tuple[Array, Array], PyTree]:
        F, b, Q, *measurements = stage
        z, P = F @ carry[0] + b, F @ carry[1] @ F.T + Q
        before, updates = (z, P), []
        for h, y, w in zip(*measurements, strict=True):
            Ph = P @ h
            inverse_variance = w / (1.0 + w * (h @ Ph))  # 1 / s, or 0
            K, e = Ph * inverse_variance, y - h @ z
            updates.append((K, h, e * inverse_variance))
            z, P = z + K * e, kalman.covariance(P, K, h, jnp.where(w > 0, 1.0 / jnp.where(w > 0, w, 1.0), 0.0))
        return (z, P), (before, [jnp.stack(columns) for columns in zip(*updates, strict=True)])

    def backward(costate: Array, stage: PyTree) -> tuple[Array, Array]:
        ((z, P), (K, h, e)), F = stage
        for j in reversed(range(K.shape[0])):
            costate = costate - h[j] * (K[j] @ costate) + h[j] * e[j]
        return F.T @ costate, z + P @ costate

    N = chain.b.shape[1]
    _, forward_pass = lax.scan(forward, (jnp.zeros(N), jnp.zeros((N, N))), tuple(chain))
    return lax.scan(backward, jnp.zeros(N), (forward_pass, chain.F), reverse=True)[1]


class Point(NamedTuple):
    """An interior point, [S, N] each: states, distances from lower and upper bounds, and their multipliers."""

    z: Array
    s: Array
    t: Array
    l: Array
    u: Array


def solve_bounded(chain: Chain, bounds: Bounds, guess: Float[Array, "S N"]) -> Float[Array, "S N"]:
    """Return the most likely states within bounds, from a guess."""
    width = bounds.high - bounds.low
    margin = jnp.where(jnp.isfinite(width), jnp.minimum(0.1 * width, bounds.size), bounds.size)
    z = jnp.clip(guess, (bounds.low + margin)[None], (bounds.high - margin)[None])
    is_bounded = [jnp.broadcast_to(jnp.isfinite(bound), z.shape) for bound in (bounds.low, bounds.high)]
    distances = [
        jnp.where(*pair, 1.0) for pair in zip(is_bounded, (z - bounds.low[None], bounds.high[None] - z), strict=True)
    ]
    multipliers = (
        jnp.where(has, INITIAL_PRODUCT / distance, 0.0) for has, distance in zip(is_bounded, distances, strict=True)
    )
    first = Point(z, *distances, *multipliers)
    return lax.fori_loop(0, STEPS, lambda _, point: newton_step(chain, is_bounded, point), first).z


def newton_step(chain: Chain, is_bounded: list[Array], point: Point) -> Point:
    """Return the point after one Newton step, shortened to stay within the bounds."""
    (low, high), (z, s, t, l, u) = is_bounded, point
    tau = jnp.maximum(CENTERING * (jnp.sum(l * s) + jnp.sum(u * t)) / (jnp.sum(low) + jnp.sum(high)), LEAST_PRODUCT)
    d, push = l / s + u / t, jnp.where(low, tau / s, 0.0) - jnp.where(high, tau / t, 0.0)
    identity = jnp.broadcast_to(jnp.eye(z.shape[1]), (*z.shape, z.shape[1]))
    target = smooth_chain(
        chain._replace(
            h=jnp.concatenate([chain.h, identity], axis=1),
            y=jnp.concatenate([chain.y, z + push / jnp.where(d > 0, d, 1.0)], axis=1),
            w=jnp.concatenate([chain.w, d], axis=1),
        )
    )
    dz = target - z
    ds, dt = jnp.where(low, dz, 0.0), jnp.where(high, -dz, 0.0)
    dl, du = jnp.where(low, (tau - l * dz) / s - l, 0.0), jnp.where(high, (tau + u * dz) / t - u, 0.0)
    pairs = [(ds, s), (dt, t), (dl, jnp.where(low, l, 1.0)), (du, jnp.where(high, u, 1.0))]
    ratio = jnp.max(jnp.stack([-change / distance for change, distance in pairs]))
    step_length = jnp.minimum(1.0, STEP_FRACTION / jnp.maximum(ratio, STEP_FRACTION))
    return Point(*(a + step_length * b for a, b in zip(point, (dz, ds, dt, dl, du), strict=True)))
