"""What every run measures, whoever watches: the plant's states, and each channel at each tick, its noise by sample.

In an open loop no observer has a part in it: runs are simulated without any, and a sample is

    y_j of sample i, taken at tick k  =  output(x_k)_j + noise_std_j v_j(i)

A sample from before tick 0 has measured x(0).
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.runtime import program_cache
from pcbench.simulation import measurement_noise, rng
from pcbench.simulation.types import GridPointParams, Layout, params_of, present


class Measured(NamedTuple):
    """Of L runs, N + 1 ticks, I samples a channel."""

    clean: Array  # [N+1, q, L] what each channel would measure at each tick without noise
    noise: Array  # [I, q, L] of each sample, scaled


def measured(layout: Layout, many: int, p: GridPointParams, root_seed: Array, seeds: Array, x: Array) -> Measured:
    """Return what runs seeds[L] measure whose states are x[N+1, n, L], of `many` samples a channel."""
    q, lanes = p.noise_std.shape[0], seeds.shape[0]
    numbers = layout.plant.drawn if layout.drifting else 0
    drawn = rng.uniforms(root_seed, seeds, "drift", jnp.asarray(0), 1, numbers)[0] if numbers else jnp.zeros((0, lanes))
    noise = measurement_noise.drawing(p, root_seed, seeds)

    def one(k: Array, x: Array, drawn: Array) -> Array:
        return layout.plant.output(params_of(layout, p, drawn), present(p, k, True), x)

    def at(row: tuple[Array, Array]) -> Array:
        return jax.vmap(one, (None, -1, -1), -1)(*row, drawn)

    clean = lax.map(at, (jnp.arange(len(x)), x))
    each = lax.map(lambda i: noise(list(range(q)), [i for _ in range(q)]), jnp.arange(many))
    return Measured(clean, p.noise_std[None, :, None] * each)


@cache
def compiled() -> Any:
    """Return `measured` compiled, once for each shape in a process."""
    return program_cache.bounded(measured, (0, 1))
