"""What a batch carries from tick to tick, the numbers that are drawn for it, and room for new directions."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.moments.bundle import Bundle
from pcbench.moments.compress import compressed
from pcbench.moments.events import Flight, Size
from pcbench.moments.sums import Sums

SCALES = (1.0, -8.0)  # of the noise in the runs that test whether a cell is affine


class Carried(NamedTuple):
    """Of C cells."""

    state: Bundle  # of State
    flight: Flight
    used: Array  # [C] directions in use
    lost: Array  # [C] the largest part of a number's size for which there was no direction
    sums: Sums
    rows: Any  # Recorded; (): nothing is recorded


def drawn(noise: Array, used: Array, size: Size, takes: Any = True) -> Bundle:
    """Return unit normals: none in the run without noise, `noise` [many] in those with noise, and a new direction for each.

    Where a cell does not take them, no direction is new.
    """
    many, (runs, _) = noise.shape[0], size.lead
    if not many:
        return Bundle(jnp.zeros((runs, 0, size.cells)), None)
    scales = jnp.asarray((0.0, *SCALES))[:runs]
    each = jnp.repeat((scales[:, None] * noise[None])[:, :, None], size.cells, 2)
    column = jnp.arange(size.directions)[:, None, None]
    place = used[None] + jnp.arange(many)[:, None]
    new = (column == place[None]) & jnp.broadcast_to(takes, used.shape)[None, None]
    return Bundle(each, jnp.concatenate([new * 1.0, each[1:]]))


def room(c: Carried, more: Array, most: int, size: Size) -> Carried:
    """Make room for `more` [C] new directions, at most `most`: where a cell has none left, all cells are compressed."""
    if not most:
        return c
    return lax.cond(jnp.any(c.used + more > size.directions), lambda c: _compressed(c, most, size), lambda c: c, c)


def _compressed(c: Carried, most: int, size: Size) -> Carried:
    """Compress the directions of all cells."""
    r, cells = size.directions, size.cells
    leaves, tree = jax.tree.flatten((c.state.directions, c.flight.values.directions, c.flight.notes.directions))
    flat = [jnp.swapaxes(a[:r].reshape(r, -1, cells), 0, 1) for a in leaves]
    B, used, lost = compressed(jnp.concatenate(flat), r - most)
    at, new = 0, []
    for a, part in zip(leaves, flat, strict=True):
        mine = jnp.swapaxes(B[at : at + len(part)], 0, 1).reshape(r, *a.shape[1:])
        new.append(jnp.concatenate([mine, a[r:]]))
        at += len(part)
    state, values, notes = jax.tree.unflatten(tree, new)
    flight = Flight(c.flight.values._replace(directions=values), c.flight.notes._replace(directions=notes))
    lost = jnp.maximum(c.lost, lost)
    return c._replace(state=c.state._replace(directions=state), flight=flight, used=used, lost=lost)
