"""What observers do alike: what they take off a measurement, y = C x + D u, note of it, and estimate."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from pcbench.protocols import Leaf, Now


def known_input(D: Float[Leaf, "q m"], now: Now, age: Int[Array, " q"]) -> Float[Array, " q"]:
    """Return D u of the time at which each channel was sampled, `age` ticks ago."""
    return jnp.stack([D[j] @ now.past_u(age[j]) for j in range(D.shape[0])])


def no_snapshot(gains: Any, memory: Any, now: Now) -> Float[Array, "0"]:
    """Note nothing when a sample is taken."""
    return jnp.zeros(0)


def xhat(gains: Any, memory: Any) -> Float[Array, " n"]:
    """Return xhat of now, of a memory that has it."""
    return memory.xhat


def kept(which: Any, after: Any, before: Any) -> Any:
    """Return the memory after an event where any of `which` holds, else the one before."""
    there = jnp.any(which)
    return jax.tree.map(lambda a, b: jnp.where(there, a, b), after, before)
