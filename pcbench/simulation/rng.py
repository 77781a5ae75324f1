"""Random numbers addressed by (root seed, seed index, stream, channel, sample index) and nothing else.

A draw does not depend on observer, order of grid points, block size, device or worker. All observers see the same noise, and a
run has the same numbers alone or among thousands. The generator is Threefry-2x32 in counter form (`threefry`), float64. No
setting of jax or of the environment changes a draw.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PyTree

from pcbench.simulation import threefry

STREAMS = {"initial": 0, "measurement": 1, "drift": 2, "jitter": 3, "loss": 4, "process": 5}
STREAMS |= {"command_jitter": 6, "command_loss": 7, "command": 8, "outlier": 9, "observer": 10, "tail": 11}
STREAMS |= {"delay_chain": 12, "dither": 13, "stamp": 14}


def run_keys(root_seed: Array, seeds: Array, stream: str, channels: int) -> list[Array]:
    """Return one key per run for each channel of a stream: `channels` arrays of keys [L]."""
    return [jax.vmap(lambda seed, c=channel: _key(root_seed, seed, stream, c))(seeds) for channel in range(channels)]


def _key(root_seed: Array, seed: Array, stream: str, channel: Array | int) -> Array:
    base = jax.random.fold_in(threefry.key(root_seed), seed)
    return jax.random.fold_in(jax.random.fold_in(base, STREAMS[stream]), channel)


def normals(keys: list[Array], index: PyTree) -> Array:
    """Draw N(0, 1) for sample index[j] of each channel j, one index for all runs or [L]: [channels, L]."""
    draw = jax.vmap(jax.vmap(lambda key, i: jax.random.normal(jax.random.fold_in(key, i), dtype=jnp.float64)))
    indices = jnp.stack([jnp.broadcast_to(index[j], key.shape) for j, key in enumerate(keys)])
    return draw(jnp.stack(keys), indices)  # stacked: the hash is compiled once instead of once per channel


def uniforms_of(keys: list[Array], index: PyTree) -> Array:
    """Draw a uniform number in [0, 1) for sample index[j] of each channel j, one index for all runs or [L]: [channels, L]."""
    draw = jax.vmap(jax.vmap(lambda key, i: jax.random.uniform(jax.random.fold_in(key, i), dtype=jnp.float64)))
    indices = jnp.stack([jnp.broadcast_to(index[j], key.shape) for j, key in enumerate(keys)])
    return draw(jnp.stack(keys), indices)


def words(root_seed: Array, seeds: Array) -> Array:
    """Return two words of each run [2, L], for an observer that draws random numbers; all observers of a run get the same."""
    return jax.random.key_data(run_keys(root_seed, seeds, "observer", 1)[0]).T


def measurement_noise(root_seed: int, seed: int, samples: int, channels: int = 1) -> Array:
    """Return the standard normal noise of one run before scaling, [channels, samples], the same for every observer.

    For users and tests. Simulations draw the same numbers sample by sample (`measurements.noise_sampler`).
    """
    keys = run_keys(jnp.asarray(root_seed), jnp.asarray([seed]), "measurement", channels)
    rows = [
        jax.vmap(lambda i, j=j: normals([keys[j]], jnp.array([i]))[0, 0])(jnp.arange(samples)) for j in range(channels)
    ]
    return jnp.stack(rows)


def uniform(keys: list[Array], index: Array) -> Array:
    """Draw a uniform number in [0, 1) of sample `index` for each channel and run: [channels, L]."""
    draw = jax.vmap(jax.vmap(lambda key: jax.random.uniform(jax.random.fold_in(key, index), dtype=jnp.float64)))
    return draw(jnp.stack(keys))


def uniforms(root_seed: Array, seeds: Array, stream: str, channel: Array, samples: int, numbers: int) -> Array:
    """Draw `numbers` uniform numbers in [0, 1) for each of the first `samples` samples of a channel: [samples, numbers, L]."""
    keys = jax.vmap(lambda seed: _key(root_seed, seed, stream, channel))(seeds)

    def draw(key: Array, index: Array) -> Array:
        return jax.random.uniform(jax.random.fold_in(key, index), (numbers,), dtype=jnp.float64)

    return jax.vmap(jax.vmap(draw, (0, None), -1), (None, 0))(keys, jnp.arange(samples))
