"""What observers do alike: what they take off a measurement, y = C x + D u, note of it, and estimate."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from pcbench.protocols import Gains, Leaf, Memory, Now, vmap_as_unit

LARGE = 100  # entries of a covariance from which functions of it are vectorized as a whole
State = TypeVar("State")


def known_input(D: Float[Leaf, "q m"], now: Now, age: Int[Array, " q"]) -> Float[Array, " q"]:
    """Return D u of the time at which each channel was sampled, `age` ticks ago."""
    return jnp.stack([D[j] @ now.past_u(age[j]) for j in range(D.shape[0])])


def no_snapshot(gains: Gains, memory: Memory, now: Now) -> Float[Array, "0"]:
    """Note nothing when a sample is taken."""
    return jnp.zeros(0)


def xhat(gains: Gains, memory: Memory) -> Float[Array, " n"]:
    """Return xhat of now, of a memory that has it."""
    return memory.xhat


def select_memory(which: Array, after: State, before: State) -> State:
    """Return the memory after an event where any of `which` holds, else the one before."""
    there = jnp.any(which)
    return jax.tree.map(lambda a, b: jnp.where(there, a, b), after, before)


def whole_if_large(P: Array, f: Callable[..., Any]) -> Callable[..., Any]:
    """Return f, vectorized over runs as a whole if P is large: entry by entry it would compile for minutes."""
    return vmap_as_unit(f) if P.size >= LARGE else f
