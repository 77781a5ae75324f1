"""Room that an observer is designed for: ages in its tables, past inputs, samples that may arrive after newer ones."""

import jax
import jax.numpy as jnp
from jax import Array

ROOM = "pcbench_within_room"  # the name by which exports recognise the function


def within_room(x: Array, mask: Array) -> Array:
    """Return x, which is meaningless unless `mask` is True.

    In a simulation the room suffices for the whole schedule, so this has no effect. An exported `jump` returns 1 instead, and
    does not change the memory.
    """
    same: Array = _same(x, mask)
    return same


def _mark_room(x: Array, mask: Array) -> Array:
    return jnp.where(mask, x, x)


_mark_room.__name__ = ROOM  # a user's function may have the name `within_room`
_same = jax.jit(_mark_room)
