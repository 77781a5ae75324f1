"""What is kept of the moments from tick to tick: expected squares and sizes over horizon and tail, and how affine a cell is."""

import operator
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.scipy.special import erf
from numpy.typing import ArrayLike, NDArray

from pcbench.moments.inputs import Numbers
from pcbench.planning.digits import EPS
from pcbench.simulation.metrics import Weights

STILL = 1e-12  # of the largest number: a standard deviation below it is rounding
AMPLIFIED = 100.0  # times the rounding of the last state: what a run with noise may be off by
FAR = 6.0  # standard deviations: a run is taken to stay within so many of the mean


class RunSignals(NamedTuple):
    """What is read of a run at a tick: of one lane, or of many arrays [..., C]."""

    errors: Array  # [Z] of all observers, in the order of their labels
    off: Array  # [r] set point less state, of a closed loop
    x: Array  # [n], and
    u: Array  # [m] of a closed loop


class Sums(NamedTuple):
    """Of Z signals in C cells; two sums of each: over the horizon, over its tail."""

    square: Numbers  # [2, Z, C] of E e^2
    absolute: Numbers  # [2, Z, C] of E |e|
    mean: Numbers  # [Z, C] at the last tick
    std: Numbers
    reach: Numbers  # [Z, C] the largest |m| + FAR s
    apart: Numbers  # [Z, C] how far a run with noise was from where linear maps put it
    size: Numbers  # [Z, C] the largest number in that comparison, of the runs themselves
    off: Numbers  # [2, r, C] of a closed loop
    cost: Numbers  # [2, C]
    input: Numbers  # [2, C]


class Read(NamedTuple):
    """What a tick gives to the sums; V numbers that are read, in the order of `RunSignals`."""

    runs: RunSignals  # [1 + P, ..., C]
    covariance: Array  # [V, V, C]; of an open loop [V, 1, C], the variances
    moved: Array  # [P, V, C] where linear maps put the runs with noise, less the run without


def nothing(signals: int, targets: int, cells: int) -> Sums:
    """Return the sums before tick 0; `targets` of a closed loop, 0 of an open one."""
    two, one, both = jnp.zeros((2, signals, cells)), jnp.zeros((signals, cells)), jnp.zeros((2, cells))
    return Sums(
        square=two,
        absolute=two,
        mean=one,
        std=one,
        reach=one,
        apart=one,
        size=one,
        off=jnp.zeros((2, targets, cells)),
        cost=both,
        input=both,
    )


def relative_deviation(s: Sums, mine: slice, reached: ArrayLike = ()) -> NDArray[np.float64]:
    """Return [Z] how far runs with noise were off, as a part of their size, in the worst realisation; 0 where that is rounding.

    An error that is 0 but for the rounding of its state has no size to compare with. `reached`: that of `Outcome`, or ().
    """
    apart, size = (np.asarray(a)[mine].max(-1) for a in (s.apart, s.size))
    with np.errstate(invalid="ignore"):
        part = np.where(apart > 0, apart / np.where(size > 0, size, 1.0), 0.0)
    part = np.where(np.isfinite(apart) & np.isfinite(size), part, np.inf)
    if np.size(reached):
        state = np.asarray(reached)[0].max(-1)[: len(part)]
        part[: len(state)][apart[: len(state)] <= AMPLIFIED * EPS * state] = 0.0
    return part


def add_tick(s: Sums, read: Read, counts: Array, weights: Weights | tuple[()], k: Array) -> Sums:
    """Take tick k into the sums; counts [2]: whether it counts, and in the tail."""
    c, runs, mean = read.covariance, read.runs.errors, read.runs.errors[0]
    square = c[:, 0] if c.shape[1] == 1 else jnp.einsum("vvc->vc", c)
    Z = mean.shape[0]
    variance = square[:Z]
    apart, large = (
        jnp.where(counts[0], reduce(jnp.maximum, jnp.abs(a)), 0.0)
        for a in (runs[1:] - (mean[None] + read.moved[:, :Z]), runs)
    )
    size = jnp.maximum(s.size, large)
    std = _root(variance, size)
    s = s._replace(
        square=_over(counts, s.square, mean * mean + variance),
        absolute=_over(counts, s.absolute, expected_size(mean, std)),
        mean=jnp.where(counts[0], mean, s.mean),
        std=jnp.where(counts[0], std, s.std),
        reach=jnp.maximum(s.reach, jnp.where(counts[0], jnp.abs(mean) + FAR * std, 0.0)),
        apart=jnp.maximum(s.apart, apart),
        size=size,
    )
    off, x, u = (a[0] for a in read.runs[1:])
    if not len(x):
        return s
    first = Z + len(off)
    n = first + len(x)
    if isinstance(weights, Weights) and weights.Q1.size:
        cost = _form(weights.Q1, x, weights.x_ref, k, c[first:n, first:n])
        cost = cost + _form(weights.Q2, u, weights.u_ref, k, c[n:, n:])
        s = s._replace(cost=_over(counts, s.cost, cost))
    return s._replace(
        off=_over(counts, s.off, off * off + square[Z:first]),
        input=_over(counts, s.input, reduce(operator.add, u * u + square[n:])),
    )


def _over(counts: Array, sums: Numbers, each: Array) -> Numbers:
    """Sums [2, ...] with numbers [...] of a tick where it counts, whatever stands at the others."""
    return sums + jnp.where(counts.reshape(2, *(1 for _ in each.shape)), each[None], 0.0)


def _form(Q: Array, mean: Array, path: Array, k: Array, covariance: Array) -> Array:
    """E z'Q z [C], z less row k of a path [T, z, C], or [T, z] of all cells, if any; Q [z, z, C], or [z, z] of all cells."""
    if path.size:
        mean = mean - (path[k] if path.ndim == 3 else path[k][:, None])
    second = covariance + mean[:, None] * mean[None]
    return jnp.sum((Q if Q.ndim == 3 else Q[:, :, None]) * second, (0, 1))


def _root(variance: Array, size: Array) -> Array:
    """Standard deviations; where they are rounding beside the numbers so far, ones without a slope."""
    std = jnp.sqrt(jnp.maximum(variance, 0.0))
    known = variance > (STILL * size) ** 2
    return jnp.where(known, jnp.sqrt(jnp.where(known, variance, 1.0)), lax.stop_gradient(std))


def expected_size(mean: Array, std: Array) -> Array:
    """Return E |e| of a normal e: s sqrt(2/pi) exp(-m^2/2s^2) + m (1 - 2 Phi(-m/s)); |m| where s = 0."""
    varies = std > 0
    far = mean / jnp.where(varies, std, 1.0)
    normal = std * jnp.sqrt(2 / jnp.pi) * jnp.exp(-far * far / 2) + mean * erf(far / jnp.sqrt(2.0))
    return jnp.where(varies, normal, jnp.abs(mean))
