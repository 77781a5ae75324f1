"""The values of measurements and their noise. Their times are in `simulation.schedule`.

In an open loop, observers do not affect the plant, so runs are simulated without them. Sample i of channel j, taken at tick k:

    y_j  =  output(x_k)_j + noise_std_j v_j(i)

A sample from before tick 0 measures x(0). If channels are correlated, v_j(i) = sum_l N_jl v_l(i) with N N' the correlation
matrix, before the steps below.

Noise and outliers
    Noise before scaling is normal or Student's t of the same variance. Outliers follow a contaminated normal (Tukey 1960):

        v = w with probability 1 - p, scale w with probability p,   w ~ N(0, 1)

    With n degrees of freedom w is replaced by

        t sqrt((n - 2) / n),   t = w sqrt(n (e^(r/n) - 1) / r),   r = w^2 + z^2,   z ~ N(0, 1)

    t has exactly Student's distribution, the sign of w, and the limit w for large n. In polar form only its radius differs
    from the normal's (Bailey, Math. Comp. 62 (1994), 779). The draw w does not depend on outliers, and the outlier indicator
    is a separate draw. So results with and without outliers use the same random numbers.

Quantization
    A channel with a quantization step D is rounded, with subtractive dither d or without (d = 0):

        D floor((y + d) / D + 1/2) - d,   d ~ U(-D/2, D/2)

    With dither the error is uniform over one step for every y, of variance D^2/12 (Schuchman, IEEE Trans. Commun. Tech. 12
    (1964), 162).

Triggering
    A sensor may send only some of its samples (`send`): those that differ enough from the last one sent, or of several
    channels the one that differs most.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.protocols import Leaf
from pcbench.simulation import rng
from pcbench.simulation.types import GridPointParams

# (channels j, index[j]: sample of each channel) -> v [len(channels), L]; with quantization, as many uniform numbers follow
Noise = Callable[[list[int], Any], Array]


class Outliers(NamedTuple):
    """Parameters of outliers."""

    probability: Leaf  # one, or [q] if channels differ
    scale: Leaf  # factor on their noise; one or [q]


class Rounding(NamedTuple):
    """Quantization of samples; q channels."""

    step: Leaf  # [q] D; 0: none
    dither: Leaf  # 1: with subtractive dither; 0: without


class Trigger(NamedTuple):
    """Event-triggered sampling; q channels."""

    threshold: Leaf  # [q] least change since the last sample sent; 0: none
    largest: Leaf  # 1: of the channels of one tick send only the one with the largest change (try-once-discard); 0: all


class Sensors(NamedTuple):
    """State of the sensors in one run."""

    values: Array  # [q] the last value sent; NaN: none yet
    n_samples: Array  # number of samples taken, over all channels
    n_sent: Array  # number of samples sent
    last_arrival: Array  # the last tick with an arrival; 0: none yet


def first_sensors(q: int) -> Sensors:
    """Return the sensor state before the first sample."""
    return Sensors(jnp.full(q, jnp.nan), jnp.zeros(()), jnp.zeros(()), jnp.asarray(0))


def send(t: Trigger, sensors: Sensors, y: Array, is_sampled: Array) -> tuple[Sensors, Array]:
    """Return the sensor state after samples y [q] of the channels `is_sampled` [q], and y with NaN where it is not sent.

    A channel that has sent nothing yet has an infinite change. If changes are equal, the first channel is sent. A change equal
    to the threshold within rounding is sent.
    """
    change = jnp.where(jnp.isnan(sensors.values), jnp.inf, jnp.abs(y - sensors.values))
    is_sent = is_sampled & (change >= t.threshold * (1 - 1e-9))
    change = jnp.where(is_sent, change / jnp.where(t.threshold > 0, t.threshold, 1.0), -1.0)
    is_sent &= (t.largest == 0) | (jnp.arange(len(y)) == jnp.argmax(change))
    values = jnp.where(is_sent, y, sensors.values)
    n_samples, n_sent = sensors.n_samples + jnp.sum(is_sampled), sensors.n_sent + jnp.sum(is_sent)
    return Sensors(values, n_samples, n_sent, sensors.last_arrival), jnp.where(is_sent, y, jnp.nan)


def quantize(r: Rounding, y: Array, uniform: Array) -> Array:
    """Return quantized samples [q]; `uniform` [q] in [0, 1) draws the dither, [0]: no dither."""
    d = r.dither * r.step * (uniform - 0.5) if uniform.shape[0] else 0.0
    step = jnp.where(r.step > 0, r.step, 1.0)
    return jnp.where(r.step > 0, step * jnp.floor((y + d) / step + 0.5) - d, y)


def student_t(w: Array, z: Array, n: Array) -> Array:
    """Return a number with Student's distribution of n degrees of freedom, scaled to variance 1, from two normal numbers.

    If n is infinite, it is w.
    """
    r, finite = w * w + z * z, jnp.isfinite(n)
    m = jnp.where(finite, n, 3.0)
    return jnp.where(finite, w * jnp.sqrt((m - 2.0) * jnp.expm1(r / m) / jnp.where(r > 0, r, 1.0)), w)


def _of_channels(a: PyTree, channels: list[int], ndim: int) -> PyTree:
    """Return the values of some channels with shape for noise whose first axis is the channel; a common value is unchanged."""
    return jnp.stack([a[j] for j in channels]).reshape(-1, *(1,) * (ndim - 1)) if jnp.ndim(a) else a


def noise_sampler(p: GridPointParams, root_seed: Array, seeds: Array, barrier: bool = False) -> Noise:
    """Return a function that draws the noise of samples of some channels.

    With `barrier`, the compiler cannot fuse the noise with the code that uses it. A run then has the same bits with and without
    outliers of probability 0.
    """
    q = p.noise_std.shape[0]
    keys = rng.run_keys(root_seed, seeds, "measurement", q)
    outlier_keys = rng.run_keys(root_seed, seeds, "outlier", q) if p.outliers else []
    tail_keys = [] if isinstance(p.student_t_dof, tuple) else rng.run_keys(root_seed, seeds, "tail", q)
    dither_keys = rng.run_keys(root_seed, seeds, "dither", q) if p.rounding else []

    def sample(channels: list[int], index: PyTree) -> Array:
        v = noise(channels, index)
        v = lax.optimization_barrier(v) if barrier else v
        if not dither_keys:
            return v
        return jnp.concatenate([v, rng.uniforms_of([dither_keys[j] for j in channels], index)])

    def normals(channels: list[int], index: PyTree) -> Array:
        if not p.noise_root.shape[0]:
            return rng.normals([keys[j] for j in channels], index)
        independent = [rng.normals(keys, [index[i]] * q) for i in range(len(channels))]
        return jnp.stack([jnp.tensordot(p.noise_root[j], w, 1) for j, w in zip(channels, independent, strict=True)])

    def noise(channels: list[int], index: PyTree) -> Array:
        v = normals(channels, index)
        if tail_keys:
            v = student_t(v, rng.normals([tail_keys[j] for j in channels], index), p.student_t_dof)
        if not p.outliers:
            return v
        probability, scale = (_of_channels(a, channels, v.ndim) for a in p.outliers)
        is_outlier = rng.uniforms_of([outlier_keys[j] for j in channels], index) < probability
        return jnp.where(is_outlier, scale * v, v)

    return sample
