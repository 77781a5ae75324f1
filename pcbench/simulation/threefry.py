"""The random number generator: Threefry-2x32 with twenty rounds, in counter form, as in jax.random.

It is implemented here, so that draws do not depend on jax's defaults. A counter and a key of two words each give two words,
modulo 2^32. On a CPU, jax.random runs its rounds as a loop of small steps. That takes 20 times as long for a thousand runs.

Source: Salmon, Moraes, Dror, Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011, with its constants.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array
from jax.extend import random as generators

ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
PARITY = 0x1BD11BDA
WORD = 32  # bits


def key(seed: Array | int) -> Array:
    """Return the generator's key for a whole number, independent of jax's settings and of the environment."""
    return jax.random.wrap_key_data(generators.threefry_prng_impl.seed(jnp.asarray(seed)), impl=_GENERATOR)


@jax.jit  # jit inside other programs: its rounds are traced once per shape
def threefry_2x32(words: Array, high: Array, low: Array) -> tuple[Array, Array]:
    """Return the two words of counters (high, low) of one shape, uint32, under the words [2] of a key."""
    keys = (words[0], words[1], words[0] ^ words[1] ^ jnp.uint32(PARITY))
    a, b = high + keys[0], low + keys[1]
    for block in range(5):
        for rotation in ROTATIONS[block % 2]:
            a = a + b
            b = ((b << jnp.uint32(rotation)) | (b >> jnp.uint32(WORD - rotation))) ^ a
        a = a + keys[(block + 1) % 3]
        b = b + keys[(block + 2) % 3] + jnp.uint32(block + 1)
    return a, b


def _bits(words: Array, width: int, shape: tuple[int, ...]) -> Array:
    """Return random bits of a shape, from the two words at the counters (0, 0), (0, 1), ..."""
    low = jnp.arange(math.prod(shape), dtype=jnp.uint32).reshape(shape)
    high, low = threefry_2x32(words, jnp.zeros_like(low), low)
    return (high.astype(jnp.uint64) << 32) | low.astype(jnp.uint64) if width == 2 * WORD else high ^ low


def _fold_in(words: Array, number: Array | int) -> Array:
    """Return the key of a whole number under a key: the two words at the counter (0, number)."""
    low = jnp.asarray(number).astype(jnp.uint32)
    return jnp.stack(threefry_2x32(words, jnp.zeros_like(low), low))


_GENERATOR = generators.define_prng_impl(
    key_shape=(2,),
    seed=generators.threefry_prng_impl.seed,
    split=generators.threefry_prng_impl.split,
    random_bits=_bits,
    fold_in=_fold_in,
    name="pcbench",
    tag="pcb",
)
