"""A quadratic program along a chain of states, with bounds: an interior point, each of whose steps is a smoother.

    min  |z_0 - m|^2_(P^-1) + sum_i |z_i - F_i z_(i-1) - b_i|^2_(Q_i^-1) + sum_ij w_ij (y_ij - h_ij' z_i)^2,  low <= z_i <= high

Without bounds it is solved by one pass of Kalman's filter forward and of Bryson and Frazier's recursion back, which divides by
no covariance: P and Q_i may be 0. With l, u the multipliers of the bounds and s, t their distances, a step adds to each entry
of each state a measurement of weight d = l / s + u / t at z + tau (1 / s - 1 / t) / d, tau a tenth of the mean of l s and u t:
Newton's step on the optimality conditions, shortened so that nothing leaves its bounds. STEPS of them, always.
Source: Bryson, Frazier 1963; Wright, Primal-Dual Interior-Point Methods, 1997, chapter 5.
Not claimed: that a bound which holds by less than 1e-8 of the prior's size is told from one that does not.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, PyTree

from pcbench.observers.parts import kalman
from pcbench.protocols import Leaf

STEPS, SHARE, NEAR = (
    25,
    0.1,
    0.99,
)  # of the interior point: how many, the aim for l s in each, how far to the bound at most
FIRST, LEAST = 1.0, 1e-14  # l s before the first; the least that is aimed at


class Chain(NamedTuple):
    """S states of N numbers, the first among them, whose F and b are of no state before it; k measurements of each."""

    F: Float[Array, "S N N"]
    b: Float[Array, "S N"]
    Q: Float[Array, "S N N"]
    h: Float[Array, "S k N"]
    y: Float[Array, "S k"]
    w: Float[Array, "S k"]  # 1 / variance; 0: none


class Bounds(NamedTuple):
    """Of every state; infinite: none."""

    low: Float[Leaf, " N"]
    high: Float[Leaf, " N"]
    size: Float[Leaf, " N"]  # what is near a bound is so by this


def smooth_chain(chain: Chain) -> Float[Array, "S N"]:
    """Return the likeliest states, without bounds."""

    def forward(carry: tuple[Array, Array], stage: PyTree) -> tuple[tuple[Array, Array], PyTree]:
        F, b, Q, *measured = stage
        z, P = F @ carry[0] + b, F @ carry[1] @ F.T + Q
        before, used = (z, P), []
        for h, y, w in zip(*measured, strict=True):
            Ph = P @ h
            part = w / (1.0 + w * (h @ Ph))  # 1 / s, or 0
            K, e = Ph * part, y - h @ z
            used.append((K, h, e * part))
            z, P = z + K * e, kalman.covariance(P, K, h, jnp.where(w > 0, 1.0 / jnp.where(w > 0, w, 1.0), 0.0))
        return (z, P), (before, [jnp.stack(each) for each in zip(*used, strict=True)])

    def backward(ahead: Array, stage: PyTree) -> tuple[Array, Array]:
        ((z, P), (K, h, e)), F = stage
        for j in reversed(range(K.shape[0])):
            ahead = ahead - h[j] * (K[j] @ ahead) + h[j] * e[j]
        return F.T @ ahead, z + P @ ahead

    N = chain.b.shape[1]
    _, passed = lax.scan(forward, (jnp.zeros(N), jnp.zeros((N, N))), tuple(chain))
    return lax.scan(backward, jnp.zeros(N), (passed, chain.F), reverse=True)[1]


class Point(NamedTuple):
    """Where the interior point stands, [S, N] each: states, and of the bounds below and above distances and multipliers."""

    z: Array
    s: Array
    t: Array
    l: Array
    u: Array


def solve_bounded(chain: Chain, bounds: Bounds, guess: Float[Array, "S N"]) -> Float[Array, "S N"]:
    """Return the likeliest states within bounds, from a guess."""
    width = bounds.high - bounds.low
    inside = jnp.where(jnp.isfinite(width), jnp.minimum(0.1 * width, bounds.size), bounds.size)
    z = jnp.clip(guess, (bounds.low + inside)[None], (bounds.high - inside)[None])
    there = [jnp.broadcast_to(jnp.isfinite(each), z.shape) for each in (bounds.low, bounds.high)]
    away = [jnp.where(*each, 1.0) for each in zip(there, (z - bounds.low[None], bounds.high[None] - z), strict=True)]
    first = Point(z, *away, *(jnp.where(has, FIRST / far, 0.0) for has, far in zip(there, away, strict=True)))
    return lax.fori_loop(0, STEPS, lambda _, at: newton_step(chain, there, at), first).z


def newton_step(chain: Chain, there: list[Array], at: Point) -> Point:
    """Return where a step of Newton's leads, as far as nothing leaves its bounds."""
    (low, high), (z, s, t, l, u) = there, at
    tau = jnp.maximum(SHARE * (jnp.sum(l * s) + jnp.sum(u * t)) / (jnp.sum(low) + jnp.sum(high)), LEAST)
    d, push = l / s + u / t, jnp.where(low, tau / s, 0.0) - jnp.where(high, tau / t, 0.0)
    each = jnp.broadcast_to(jnp.eye(z.shape[1]), (*z.shape, z.shape[1]))
    aim = smooth_chain(
        chain._replace(
            h=jnp.concatenate([chain.h, each], axis=1),
            y=jnp.concatenate([chain.y, z + push / jnp.where(d > 0, d, 1.0)], axis=1),
            w=jnp.concatenate([chain.w, d], axis=1),
        )
    )
    dz = aim - z
    ds, dt = jnp.where(low, dz, 0.0), jnp.where(high, -dz, 0.0)
    dl, du = jnp.where(low, (tau - l * dz) / s - l, 0.0), jnp.where(high, (tau + u * dz) / t - u, 0.0)
    pairs = [(ds, s), (dt, t), (dl, jnp.where(low, l, 1.0)), (du, jnp.where(high, u, 1.0))]
    length = jnp.minimum(1.0, NEAR / jnp.maximum(jnp.max(jnp.stack([-move / room for move, room in pairs])), NEAR))
    return Point(*(a + length * b for a, b in zip(at, (dz, ds, dt, dl, du), strict=True)))
