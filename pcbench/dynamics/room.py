"""The room that an observer is designed with: ages in its tables, past inputs, measurements that newer ones may overtake."""

import jax
import jax.numpy as jnp
from jax import Array

ROOM = "pcbench_within_room"  # the name by which exports know the function


def within_room(x: Array, within: Array) -> Array:
    """Return x, which is meaningless where it is not `within` the room.

    In a simulation there is room for the whole schedule, so this changes nothing. An exported `jump` returns 1 instead, and
    leaves the memory as it is.
    """
    same: Array = _same(x, within)
    return same


def _mark_room(x: Array, within: Array) -> Array:
    return jnp.where(within, x, x)


_mark_room.__name__ = ROOM  # a user's own function may be called `within_room`
_same = jax.jit(_mark_room)
