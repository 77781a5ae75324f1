"""Running sums of the moments: expected squares and absolute errors over run and tail, and the deviation from affine."""

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

STILL = 1e-12  # relative to the largest number: a smaller standard deviation is rounding
AMPLIFIED = 100.0  # allowed deviation of a run with noise, in multiples of the rounding of the last state
FAR = 6.0  # standard deviations from the mean within which a run is assumed to stay


class RunSignals(NamedTuple):
    """The signals of a run that are read at a tick: of one run, or of many, arrays [..., C]."""

    errors: Array  # [Z] of all observers, in the order of their labels
    tracking: Array  # [r] set point minus state, in a closed loop
    x: Array  # [n], and
    u: Array  # [m] of a closed loop


class Sums(NamedTuple):
    """Sums of Z signals at C grid points; two sums each: over the run, over its tail."""

    square: Numbers  # [2, Z, C] of E e^2
    absolute: Numbers  # [2, Z, C] of E |e|
    mean: Numbers  # [Z, C] at the last tick
    std: Numbers
    reach: Numbers  # [Z, C] the largest |m| + FAR s
    deviation: Numbers  # [Z, C] largest deviation of a run with noise from the linear maps
    size: Numbers  # [Z, C] largest number in that comparison, over the runs
    tracking: Numbers  # [2, r, C] of a closed loop
    cost: Numbers  # [2, C]
    input: Numbers  # [2, C]


class TickValues(NamedTuple):
    """The values that a tick adds to the sums; V numbers in the order of `RunSignals`."""

    runs: RunSignals  # [1 + P, ..., C]
    covariance: Array  # [V, V, C]; of an open loop [V, 1, C], the variances
    shifts: Array  # [P, V, C] linear prediction of the runs with noise, minus the run without


def zero_sums(signals: int, targets: int, cells: int) -> Sums:
    """Return the sums before tick 0; `targets` of a closed loop, 0 of an open one."""
    two, one, pair = jnp.zeros((2, signals, cells)), jnp.zeros((signals, cells)), jnp.zeros((2, cells))
    return Sums(
        square=two,
        absolute=two,
        mean=one,
        std=one,
        reach=one,
        deviation=one,
        size=one,
        tracking=jnp.zeros((2, targets, cells)),
        cost=pair,
        input=pair,
    )


def relative_deviation(s: Sums, signals: slice, final_state: ArrayLike = ()) -> NDArray[np.float64]:
    """Return the relative deviation of runs with noise, [Z], in the worst realisation; 0 if it is rounding.

    An error that is 0 except for the rounding of its state has no size for comparison. `final_state` is as in `Outcome`, or ().
    """
    deviation, size = (np.asarray(a)[signals].max(-1) for a in (s.deviation, s.size))
    with np.errstate(invalid="ignore"):
        ratio = np.where(deviation > 0, deviation / np.where(size > 0, size, 1.0), 0.0)
    ratio = np.where(np.isfinite(deviation) & np.isfinite(size), ratio, np.inf)
    if np.size(final_state):
        state = np.asarray(final_state)[0].max(-1)[: len(ratio)]
        ratio[: len(state)][deviation[: len(state)] <= AMPLIFIED * EPS * state] = 0.0
    return ratio


def add_tick(s: Sums, values: TickValues, counts: Array, weights: Weights | tuple[()], k: Array) -> Sums:
    """Add tick k to the sums; counts [2]: whether it counts for the run, and for the tail."""
    c, runs, mean = values.covariance, values.runs.errors, values.runs.errors[0]
    square = c[:, 0] if c.shape[1] == 1 else jnp.einsum("vvc->vc", c)
    Z = mean.shape[0]
    variance = square[:Z]
    deviation, largest = (
        jnp.where(counts[0], reduce(jnp.maximum, jnp.abs(a)), 0.0)
        for a in (runs[1:] - (mean[None] + values.shifts[:, :Z]), runs)
    )
    size = jnp.maximum(s.size, largest)
    std = _std(variance, size)
    s = s._replace(
        square=_add(counts, s.square, mean * mean + variance),
        absolute=_add(counts, s.absolute, mean_size(mean, std)),
        mean=jnp.where(counts[0], mean, s.mean),
        std=jnp.where(counts[0], std, s.std),
        reach=jnp.maximum(s.reach, jnp.where(counts[0], jnp.abs(mean) + FAR * std, 0.0)),
        deviation=jnp.maximum(s.deviation, deviation),
        size=size,
    )
    tracking, x, u = (a[0] for a in values.runs[1:])
    if not len(x):
        return s
    first = Z + len(tracking)
    n = first + len(x)
    if isinstance(weights, Weights) and weights.Q1.size:
        cost = _expected_square(weights.Q1, x, weights.x_ref, k, c[first:n, first:n])
        cost = cost + _expected_square(weights.Q2, u, weights.u_ref, k, c[n:, n:])
        s = s._replace(cost=_add(counts, s.cost, cost))
    return s._replace(
        tracking=_add(counts, s.tracking, tracking * tracking + square[Z:first]),
        input=_add(counts, s.input, reduce(operator.add, u * u + square[n:])),
    )


def _add(counts: Array, sums: Numbers, numbers: Array) -> Numbers:
    """Return sums [2, ...] plus the numbers [...] of a tick where it counts; other numbers may be anything."""
    return sums + jnp.where(counts.reshape(2, *(1 for _ in numbers.shape)), numbers[None], 0.0)


def _expected_square(Q: Array, mean: Array, path: Array, k: Array, covariance: Array) -> Array:
    """Return E z'Q z [C] of z minus row k of a path [T, z, C], or [T, z] common to all, if any; Q [z, z, C] or [z, z]."""
    if path.size:
        mean = mean - (path[k] if path.ndim == 3 else path[k][:, None])
    second = covariance + mean[:, None] * mean[None]
    return jnp.sum((Q if Q.ndim == 3 else Q[:, :, None]) * second, (0, 1))


def _std(variance: Array, size: Array) -> Array:
    """Return standard deviations; where they are rounding relative to the numbers so far, without a slope."""
    std = jnp.sqrt(jnp.maximum(variance, 0.0))
    is_significant = variance > (STILL * size) ** 2
    return jnp.where(is_significant, jnp.sqrt(jnp.where(is_significant, variance, 1.0)), lax.stop_gradient(std))


def mean_size(mean: Array, std: Array) -> Array:
    """Return E |e| of a normal e: s sqrt(2/pi) exp(-m^2/2s^2) + m (1 - 2 Phi(-m/s)); |m| where s = 0."""
    varies = std > 0
    z = mean / jnp.where(varies, std, 1.0)
    normal = std * jnp.sqrt(2 / jnp.pi) * jnp.exp(-z * z / 2) + mean * erf(z / jnp.sqrt(2.0))
    return jnp.where(varies, normal, jnp.abs(mean))
