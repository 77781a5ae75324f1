"""The noise of samples before scaling, by channel and sample: normal, but for outliers.

    v = w with probability 1 - p, scale w with probability p,   w ~ N(0, 1)

(the contaminated normal: Tukey 1960). w has the address of the sample's noise whether there are outliers or not, and which
samples are outliers is drawn beside it: with and without them a study stands on the same draws.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from pcbench.protocols import Leaf
from pcbench.simulation import draws
from pcbench.simulation.problem import Problem

Noise = Callable[[list[int], Any], Array]  # (channels j, index[j] of the sample of each) -> v [len(channels), L]


class Outliers(NamedTuple):
    """Which samples are."""

    probability: Leaf
    scale: Leaf  # of their noise


def drawing(p: Problem, root_seed: Array, seeds: Array) -> Noise:
    """Return what draws the noise of samples of some channels."""
    many = p.noise_std.shape[0]
    keys = draws.run_keys(root_seed, seeds, "measurement", many)
    odd = draws.run_keys(root_seed, seeds, "outlier", many) if p.outliers else []

    def noise(channels: list[int], index: Any) -> Array:
        v = draws.normals([keys[j] for j in channels], index)
        if not p.outliers:
            return v
        out = draws.uniforms_of([odd[j] for j in channels], index) < p.outliers.probability
        return jnp.where(out, p.outliers.scale * v, v)

    return noise
