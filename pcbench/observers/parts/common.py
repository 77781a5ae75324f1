"""Small functions that many observers share."""

import operator
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int, PyTree

from pcbench.protocols import Gains, Leaf, Memory, Now, vmap_as_unit

LARGE = 100  # entries of a covariance from which on functions of it are vectorized as a unit
State = TypeVar("State")


def known_input(D: Float[Leaf, "q m"], now: Now, age: Int[Array, " q"]) -> Float[Array, " q"]:
    """Return D u [q] at the sampling time of each channel, `age` ticks ago."""
    return jnp.stack([D[j] @ now.past_u(age[j]) for j in range(D.shape[0])])


def no_snapshot(gains: Gains, memory: Memory, now: Now) -> Float[Array, "0"]:
    """Return an empty snapshot."""
    return jnp.zeros(0)


def xhat(gains: Gains, memory: Memory) -> Float[Array, " n"]:
    """Return `memory.xhat`."""
    return memory.xhat


def select_memory(mask: Array, after: State, before: State) -> State:
    """Return the memory `after` an event if any of `mask` is True, else the one `before`."""
    condition = jnp.any(mask)
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), after, before)


def vmap_large_as_unit(P: Array, f: Callable[..., Any]) -> Callable[..., Any]:
    """Return f, marked by `vmap_as_unit` if P is large: vectorized entry by entry, it would compile for minutes."""
    return vmap_as_unit(f) if P.size >= LARGE else f


def for_each_channel(
    use: Callable[[State, PyTree], tuple[State, PyTree]], state: State, channels: PyTree
) -> tuple[State, PyTree]:
    """Return the state after use(state, channel) of one channel after the other, and the other results of all channels.

    Several channels are a loop, which compiles faster.
    """
    if jax.tree.leaves(channels)[0].shape[0] > 1:
        return lax.scan(use, state, channels)
    state, result = use(state, jax.tree.map(operator.itemgetter(0), channels))
    return state, jax.tree.map(lambda a: a[None], result)
