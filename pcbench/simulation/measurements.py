"""The values of measurements and their noise, not when they arrive, which is decided in `simulation.schedule`.

A run has the plant's states, the clean output of each channel at each tick, and its noise by sample. In an open loop no
observer has a part in it: runs are simulated without any, and a sample is

    y_j of sample i, taken at tick k  =  output(x_k)_j + noise_std_j v_j(i)

A sample from before tick 0 has measured x(0). Where the noise of channels is correlated, v_j(i) = sum_l N_jl v_l(i) with
N N' the correlation, before what follows.

The noise of samples before scaling, by channel and sample: normal, or Student's t of the same variance; and outliers.

    v = w with probability 1 - p, scale w with probability p,   w ~ N(0, 1)

(the contaminated normal: Tukey 1960). With n degrees of freedom w is replaced by

    t sqrt((n - 2) / n),   t = w sqrt(n (e^(r/n) - 1) / r),   r = w^2 + z^2,   z ~ N(0, 1)

which is Student's t exactly (Bailey, Math. Comp. 62 (1994), 779: in polar form its radius alone differs from the normal's), has
the sign of w, and goes to w as n grows. w has the address of the sample's noise whether there are outliers or not, and which
samples are outliers is drawn beside it: with and without them a study stands on the same draws.

What comes out is rounded to whole steps D, where a channel has them, with subtractive dither d or with none:

    D floor((y + d) / D + 1/2) - d,   d ~ U(-D/2, D/2)

whose error is then uniform over one step, of variance D^2/12, whatever y is (Schuchman, IEEE Trans. Commun. Tech. 12
(1964), 162).

A sensor may send only some of its samples (`send`): those that differ enough from the last that it sent, or of several outputs
the one that differs most.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.protocols import Leaf
from pcbench.simulation import rng
from pcbench.simulation.types import GridPointParams

# (channels j, index[j] of the sample of each) -> v [len(channels), L]; where samples are rounded as many uniform numbers after
Noise = Callable[[list[int], Any], Array]


class Outliers(NamedTuple):
    """Which samples are."""

    probability: Leaf  # one, or [q] where channels differ
    scale: Leaf  # of their noise; likewise


class Rounding(NamedTuple):
    """How samples are rounded; q channels."""

    step: Leaf  # [q] D; 0: not at all
    dither: Leaf  # 1: with subtractive dither; 0: without


class Trigger(NamedTuple):
    """Which samples are sent; q channels."""

    threshold: Leaf  # [q] least change since the last sample sent; 0: any
    largest: Leaf  # 1: of the channels of one time only the one with the largest change (try-once-discard); 0: all


class Sensors(NamedTuple):
    """What the sensors of one run keep."""

    held: Array  # [q] the last value sent; NaN: none yet
    taken: Array  # how many samples of channels were taken, and
    sent: Array  # how many of them were sent
    last: Array  # the last tick at which one arrived; 0: none yet


def first_sensors(q: int) -> Sensors:
    """Return the sensors before the first sample."""
    return Sensors(jnp.full(q, jnp.nan), jnp.zeros(()), jnp.zeros(()), jnp.asarray(0))


def send(t: Trigger, sensors: Sensors, y: Array, taken: Array) -> tuple[Sensors, Array]:
    """Return the sensors after samples y [q] of the channels `taken` [q], and y with NaN where it is not sent.

    A channel that has sent nothing yet counts as changed without limit; of equal changes the first channel is sent. A change
    that is the threshold but for rounding is sent.
    """
    change = jnp.where(jnp.isnan(sensors.held), jnp.inf, jnp.abs(y - sensors.held))
    sent = taken & (change >= t.threshold * (1 - 1e-9))
    change = jnp.where(sent, change / jnp.where(t.threshold > 0, t.threshold, 1.0), -1.0)
    sent &= (t.largest == 0) | (jnp.arange(len(y)) == jnp.argmax(change))
    held, many = jnp.where(sent, y, sensors.held), (sensors.taken + jnp.sum(taken), sensors.sent + jnp.sum(sent))
    return Sensors(held, *many, sensors.last), jnp.where(sent, y, jnp.nan)


def quantize(r: Rounding, y: Array, uniform: Array) -> Array:
    """Return samples [q] as they come out; `uniform` [q] in [0, 1) is what dither is drawn by, [0]: there is none."""
    d = r.dither * r.step * (uniform - 0.5) if uniform.shape[0] else 0.0
    step = jnp.where(r.step > 0, r.step, 1.0)
    return jnp.where(r.step > 0, step * jnp.floor((y + d) / step + 0.5) - d, y)


def students(w: Array, z: Array, n: Array) -> Array:
    """Return what has Student's distribution with n degrees of freedom, scaled to variance 1, of two normal numbers.

    It is w where n is infinite.
    """
    r, finite = w * w + z * z, jnp.isfinite(n)
    m = jnp.where(finite, n, 3.0)
    return jnp.where(finite, w * jnp.sqrt((m - 2.0) * jnp.expm1(r / m) / jnp.where(r > 0, r, 1.0)), w)


def _of_channels(a: PyTree, channels: list[int], ndim: int) -> PyTree:
    """What some channels have, to go with noise whose first axis they are; as it is where it is one for all."""
    return jnp.stack([a[j] for j in channels]).reshape(-1, *(1,) * (ndim - 1)) if jnp.ndim(a) else a


def noise_sampler(p: GridPointParams, root_seed: Array, seeds: Array, apart: bool = False) -> Noise:
    """Return what draws the noise of samples of some channels.

    With `apart` a compiler cannot fuse the noise with what uses it: a run then has the same bits with and without outliers of
    probability 0.
    """
    many = p.noise_std.shape[0]
    keys = rng.run_keys(root_seed, seeds, "measurement", many)
    odd = rng.run_keys(root_seed, seeds, "outlier", many) if p.outliers else []
    beside = [] if isinstance(p.tail, tuple) else rng.run_keys(root_seed, seeds, "tail", many)

    dither = rng.run_keys(root_seed, seeds, "dither", many) if p.rounding else []

    def drawn(channels: list[int], index: PyTree) -> Array:
        v = noise(channels, index)
        v = lax.optimization_barrier(v) if apart else v
        return jnp.concatenate([v, rng.uniforms_of([dither[j] for j in channels], index)]) if dither else v

    def normals(channels: list[int], index: PyTree) -> Array:
        if not p.noise_root.shape[0]:
            return rng.normals([keys[j] for j in channels], index)
        each = [rng.normals(keys, [index[i]] * many) for i in range(len(channels))]
        return jnp.stack([jnp.tensordot(p.noise_root[j], w, 1) for j, w in zip(channels, each, strict=True)])

    def noise(channels: list[int], index: PyTree) -> Array:
        v = normals(channels, index)
        if beside:
            v = students(v, rng.normals([beside[j] for j in channels], index), p.tail)
        if not p.outliers:
            return v
        probability, scale = (_of_channels(a, channels, v.ndim) for a in p.outliers)
        out = rng.uniforms_of([odd[j] for j in channels], index) < probability
        return jnp.where(out, scale * v, v)

    return drawn
