"""What is kept of the moments from tick to tick: expected squares and sizes over horizon and tail, and how affine a cell is."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.scipy.special import erf

from pcbench.moments.bundle import Bundle
from pcbench.moments.events import Size
from pcbench.moments.given import Given
from pcbench.simulation.metrics import Weights

FAR = 6.0  # standard deviations: a run is taken to stay within so many of the mean


class Seen(NamedTuple):
    """What is read of a run at a tick, for one lane."""

    errors: Any  # [Z] of all observers, in the order of their labels
    off: Any  # [r] set point less state, of a closed loop
    x: Any  # [n], and
    u: Any  # [m] of a closed loop


class Sums(NamedTuple):
    """Of Z signals in C cells; two sums of each: over the horizon, over its tail."""

    square: Array  # [2, Z, C] of E e^2
    absolute: Array  # [2, Z, C] of E |e|
    mean: Array  # [Z, C] at the last tick
    std: Array
    reach: Array  # [Z, C] the largest |m| + FAR s
    apart: Array  # [Z, C] how far a run with noise was from where its direction says
    size: Array  # [Z, C] the largest number in that comparison
    off: Any = ()  # [2, r, C] of a closed loop
    cost: Any = ()  # [2, C]
    input: Any = ()  # [2, C]


def nothing(signals: int, targets: int | None, cells: int) -> Sums:
    """Return the sums before tick 0; `targets` of a closed loop."""
    two, one = jnp.zeros((2, signals, cells)), jnp.zeros((signals, cells))
    sums = Sums(two, two, one, one, one, one, one)
    if targets is None:
        return sums
    both = jnp.zeros((2, cells))
    return sums._replace(off=jnp.zeros((2, targets, cells)), cost=both, input=both)


def moments(seen: Bundle, name: str, size: Size) -> tuple[Array, Array]:
    """Return mean [numbers, C] and directions [r, numbers, C] of what was read."""
    runs, along = (getattr(part, name) for part in seen)
    if along is None:
        return runs[0], jnp.zeros((size.directions, *runs.shape[1:]))
    return runs[0], along[: size.directions]


def added(s: Sums, seen: Bundle, weight: Array, given: Given, size: Size) -> Sums:
    """Take a tick into the sums; weight [2] says into which."""
    s = _errors(s, seen, weight, size)
    if isinstance(s.input, tuple):
        return s
    x, u, off = (moments(seen, name, size) for name in ("x", "u", "off"))
    weights = given.problem.weights
    if isinstance(weights, Weights) and weights.Q1.size:
        square = _form(weights.Q1, *x) + _form(weights.Q2, *u)
        s = s._replace(cost=s.cost + weight[:, None] * square[None])
    squares = jnp.sum(_square(*u), 0)
    late = s.off + weight[:, None, None] * _square(*off)[None]
    return s._replace(off=late, input=s.input + weight[:, None] * squares[None])


def _square(mean: Array, along: Array) -> Array:
    return mean * mean + jnp.sum(along * along, 0)


def _form(Q: Array, mean: Array, along: Array) -> Array:
    """E z'Q z [C], of Q [n, n, C], or [n, n] of all cells."""
    each = jnp.concatenate([mean[None], along])
    return jnp.einsum("ric,ijc,rjc->c" if Q.ndim == 3 else "ric,ij,rjc->c", each, Q, each)


def _errors(s: Sums, seen: Bundle, weight: Array, size: Size) -> Sums:
    runs, along = seen.runs.errors, seen.directions.errors
    mean, variance, twins = runs[0], jnp.sum(along[: size.directions] ** 2, 0), along[size.directions :]
    std = jnp.sqrt(variance)
    apart = jnp.abs(runs[1:] - (mean[None] + twins))
    large = jnp.max(jnp.abs(runs), 0) + jnp.max(jnp.abs(twins), 0)
    scored, weight = weight[0] > 0, weight[:, None, None]
    return s._replace(
        square=s.square + weight * (mean * mean + variance)[None],
        absolute=s.absolute + weight * expected_size(mean, std)[None],
        mean=jnp.where(scored, mean, s.mean),
        std=jnp.where(scored, std, s.std),
        reach=jnp.maximum(s.reach, jnp.abs(mean) + FAR * std),
        apart=jnp.maximum(s.apart, jnp.max(apart, 0)),
        size=jnp.maximum(s.size, large),
    )


def expected_size(mean: Array, std: Array) -> Array:
    """Return E |e| of a normal e: s sqrt(2/pi) exp(-m^2/2s^2) + m (1 - 2 Phi(-m/s)); |m| where s = 0."""
    varies = std > 0
    far = mean / jnp.where(varies, std, 1.0)
    found = std * jnp.sqrt(2 / jnp.pi) * jnp.exp(-far * far / 2) + mean * erf(far / jnp.sqrt(2.0))
    return jnp.where(varies, found, jnp.abs(mean))
