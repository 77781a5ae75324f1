"""Products of a small matrix with the numbers of every lane, and with those that lanes have in common.

With few numbers a product is written out as sums of products entry by entry: so it is computed in the loop of what uses it, and
nothing is kept between. With many, a product of matrices is as fast, and compiled sooner.

The chunks that a flow goes by: from an event, or a window's edge, 64 ticks at a time, then what is left.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.simulation.types import GridPointParams

FEW = 10  # own numbers of a lane, at most, that are written out


def same(M: Array, shared: Array) -> Array:
    """Return what is the same in all lanes: M [m, 1 + S] with 1 and the shared numbers [S]."""
    return M @ jnp.append(1.0, shared)


def few(own: int) -> bool:
    """Say whether products with so many numbers of a lane's own are written out."""
    return own <= FEW


def of_lanes(M: Array, fixed: Array, own: Array) -> Array:
    """Return fixed [m] + M [m, r] with the own numbers of every lane [r, L]: [m, L]."""
    if not few(len(own)):
        return jnp.concatenate([fixed[:, None], M], 1) @ jnp.concatenate([jnp.ones((1, own.shape[1])), own])
    return reduce(jnp.add, (M[:, j, None] * own[None, j] for j in range(len(own))), fixed[:, None])


TICKS = 64  # of a chunk at most
BLOCK = 8  # of them in one product: with 4 or 16 the product and its sums take more a tick
WRITTEN = 32  # of them at once where products are written out (`products`): 16 or 64 take more a tick
LANES = 64  # chunks are so many, or twice as many ...: their numbers then fill vectors, and few programs differ in them
MOST = 2**17  # ticks in chunks: an observer of two states takes 20 MB for them
FEWEST = 2**11  # ticks of a run: of fewer, all that is saved is less than the larger program takes to compile
SPARSE = 2 * BLOCK  # ticks an event, at least: below, stepping is as fast


class Chunks(NamedTuple):
    """C chunks of N ticks; those beyond the last have no ticks."""

    start: Array  # [C] first tick
    length: Array  # [C] ticks
    before: Array  # [N+2] how many chunks begin before each tick


def room(event: np.ndarray, windows: int) -> int:
    """Return room for the chunks of a schedule, whatever its windows; 0 where it is to be stepped.

    That is where events are too dense, or ticks too many or too few.
    """
    lengths = np.diff(np.append(np.flatnonzero(event), len(event)))
    many = int((-(-lengths // TICKS)).sum()) + windows
    many += -many % LANES
    long = len(event) >= FEWEST and many * TICKS <= MOST
    return many if long and len(event) >= SPARSE * len(lengths) else 0


def chunks(p: GridPointParams, room: int) -> Chunks:
    """Return the chunks of a schedule and its windows, up to the last tick."""
    ticks, end = p.schedule.event.shape[0], p.windows[-1, 0]
    edge = p.schedule.event.at[p.windows[:, 0]].set(True)
    k = jnp.arange(ticks)
    begins = ((k - lax.cummax(jnp.where(edge, k, 0))) % TICKS == 0) & (k < end)
    (start,) = jnp.nonzero(begins, size=room, fill_value=end)
    following = lax.cummin(jnp.where(edge, k, ticks), reverse=True)
    stop = jnp.minimum(jnp.append(following, ticks)[start + 1], end)
    before = jnp.concatenate([jnp.zeros(1, int), jnp.cumsum(begins)])
    return Chunks(start, jnp.minimum(stop - start, TICKS), before)
