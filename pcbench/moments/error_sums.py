"""What is kept of the moments from tick to tick: expected squares and sizes over horizon and tail, and how affine a cell is."""

import operator
from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.scipy.special import erf
from numpy.typing import NDArray

from pcbench.planning.digits import EPS
from pcbench.simulation.metrics import Weights

STILL = 1e-12  # of the largest number: a standard deviation below it is rounding
AMPLIFIED = 100.0  # times the rounding of the last state: what a run with noise may be off by
FAR = 6.0  # standard deviations: a run is taken to stay within so many of the mean


class Seen(NamedTuple):
    """What is read of a run at a tick: of one lane, or of many arrays [..., C]."""

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
    apart: Array  # [Z, C] how far a run with noise was from where linear maps put it
    size: Array  # [Z, C] the largest number in that comparison, of the runs themselves
    off: Any = ()  # [2, r, C] of a closed loop
    cost: Any = ()  # [2, C]
    input: Any = ()  # [2, C]


class Read(NamedTuple):
    """What J ticks give to the sums; V numbers that are read, in the order of `Seen`."""

    runs: Seen  # [J, 1 + P, ..., C]
    covariance: Array  # [J, V, V, C]; of an open loop [J, V, 1, C], the variances
    moved: Array  # [J, P, V, C] where linear maps put the runs with noise, less the run without


def nothing(signals: int, targets: int | None, cells: int) -> Sums:
    """Return the sums before tick 0; `targets` of a closed loop."""
    two, one = jnp.zeros((2, signals, cells)), jnp.zeros((signals, cells))
    sums = Sums(square=two, absolute=two, mean=one, std=one, reach=one, apart=one, size=one)
    if targets is None:
        return sums
    both = jnp.zeros((2, cells))
    return sums._replace(off=jnp.zeros((2, targets, cells)), cost=both, input=both)


def strayed(s: Sums, mine: slice, reached: Any = ()) -> NDArray[np.float64]:
    """Return [Z] how far runs with noise were off, as a part of their size, in the worst realisation; 0 where that is rounding.

    An error that is 0 but for the rounding of its state has no size to compare with. `reached` as in `Found`, or ().
    """
    apart, size = (np.asarray(a)[mine].max(-1) for a in (s.apart, s.size))
    with np.errstate(invalid="ignore"):
        part = np.where(apart > 0, apart / np.where(size > 0, size, 1.0), 0.0)
    part = np.where(np.isfinite(apart) & np.isfinite(size), part, np.inf)
    if np.size(reached):
        state = np.asarray(reached)[0].max(-1)[: len(part)]
        part[: len(state)][apart[: len(state)] <= AMPLIFIED * EPS * state] = 0.0
    return part


def variances(read: Read) -> Array:
    """Return the variances [J, V, C] of what was read."""
    c = read.covariance
    return c[:, :, 0] if c.shape[2] == 1 else jnp.einsum("jvvc->jvc", c)


def added(s: Sums, read: Read, weight: Array, weights: Any, at: Array) -> Sums:
    """Take ticks `at` [J] into the sums; weight [2, J]: which count, and of those which in the tail; others are the last."""
    s = _errors(s, read, weight)
    if isinstance(s.input, tuple):
        return s
    z, r = read.runs.errors.shape[2], read.runs.off.shape[2]
    first, n = z + r, read.runs.x.shape[2]
    square = variances(read)
    mean_off, x, u = read.runs.off[:, 0], read.runs.x[:, 0], read.runs.u[:, 0]
    if isinstance(weights, Weights) and weights.Q1.size:
        state, pushed = slice(first, first + n), slice(first + n, None)
        off, more = (_less(a, table, at) for a, table in ((x, weights.x_ref), (u, weights.u_ref)))
        cost = _form(weights.Q1, off, read.covariance[:, state, state]) + _form(
            weights.Q2, more, read.covariance[:, pushed, pushed]
        )
        s = s._replace(cost=s.cost + _over(weight, cost))
    squares = total(u * u + square[:, first + n :], 1)
    late = s.off + _over(weight, mean_off * mean_off + square[:, z:first])
    return s._replace(off=late, input=s.input + _over(weight, squares))


def _over(weight: Array, each: Array) -> Array:
    """The sums [2, ...] over the ticks that count of numbers [J, ...], whatever stands at the others."""
    return total(jnp.where(weight.reshape(*weight.shape, *(1 for _ in each.shape[1:])), each[None], 0.0), 1)


def total(a: Array, axis: int) -> Array:
    """The sum along a short axis, written out: compiled as a sum it takes twenty times as long."""
    return reduce(operator.add, _each(a, axis))


def largest(a: Array, axis: int) -> Array:
    """The largest along a short axis, likewise."""
    return reduce(jnp.maximum, _each(a, axis))


def _each(a: Array, axis: int) -> list[Array]:
    return [lax.index_in_dim(a, i, axis, keepdims=False) for i in range(a.shape[axis])]


def _less(mean: Array, table: Array, at: Array) -> Array:
    """A mean [J, z, C] less the rows `at` of a table [T, z, C], or [T, z] of all cells; of an empty one as it is."""
    if not table.size:
        return mean
    return mean - (table[at] if table.ndim == 3 else table[at][..., None])


def _form(Q: Array, mean: Array, covariance: Array) -> Array:
    """E z'Q z [J, C], of Q [n, n, C], or [n, n] of all cells."""
    second = covariance + mean[:, :, None] * mean[:, None]
    return jnp.sum((Q if Q.ndim == 3 else Q[:, :, None])[None] * second, (1, 2))


def _errors(s: Sums, read: Read, weight: Array) -> Sums:
    runs, counts = read.runs.errors, weight[0]
    mean, z = runs[:, 0], runs.shape[2]
    variance, moved = variances(read)[:, :z], read.moved[:, :, :z]
    counted = counts[:, None, None]
    apart = largest(jnp.abs(runs[:, 1:] - (mean[:, None] + moved)), 1)
    large = largest(jnp.abs(runs), 1)
    size = jnp.maximum(s.size, largest(jnp.where(counted, large, 0.0), 0))
    std = _root(variance, size[None])
    last, any_counts = jnp.maximum(jnp.sum(counts) - 1, 0), jnp.any(counts)
    return s._replace(
        square=s.square + _over(weight, mean * mean + variance),
        absolute=s.absolute + _over(weight, expected_size(mean, std)),
        mean=jnp.where(any_counts, mean[last], s.mean),
        std=jnp.where(any_counts, std[last], s.std),
        reach=jnp.maximum(s.reach, largest(jnp.where(counted, jnp.abs(mean) + FAR * std, 0.0), 0)),
        apart=jnp.maximum(s.apart, largest(jnp.where(counted, apart, 0.0), 0)),
        size=size,
    )


def _root(variance: Array, size: Array) -> Array:
    """Standard deviations; where they are rounding beside the numbers so far, ones without a slope."""
    std = jnp.sqrt(jnp.maximum(variance, 0.0))
    known = variance > (STILL * size) ** 2
    return jnp.where(known, jnp.sqrt(jnp.where(known, variance, 1.0)), lax.stop_gradient(std))


def expected_size(mean: Array, std: Array) -> Array:
    """Return E |e| of a normal e: s sqrt(2/pi) exp(-m^2/2s^2) + m (1 - 2 Phi(-m/s)); |m| where s = 0."""
    varies = std > 0
    far = mean / jnp.where(varies, std, 1.0)
    found = std * jnp.sqrt(2 / jnp.pi) * jnp.exp(-far * far / 2) + mean * erf(far / jnp.sqrt(2.0))
    return jnp.where(varies, found, jnp.abs(mean))
