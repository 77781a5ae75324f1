"""The part of a measurement that the input makes at once: y = C x + D u."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from pcbench.protocols import Leaf, Now


def known_input(D: Float[Leaf, "q m"], now: Now, age: Int[Array, " q"]) -> Float[Array, " q"]:
    """Return D u of the time at which each channel was sampled, `age` ticks ago."""
    return jnp.stack([D[j] @ now.past_u(age[j]) for j in range(D.shape[0])])
