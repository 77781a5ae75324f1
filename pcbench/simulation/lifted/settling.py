"""The last exit from the band: what each lane was at the start of the last chunk with one is kept, and looked at in the end."""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation.lifted import products
from pcbench.simulation.lifted.chunks import TICKS, Chunks
from pcbench.simulation.lifted.maps import Maps, Moving
from pcbench.simulation.lifted.sums import limits


class Exits(NamedTuple):
    """Of one observer; n signals, C chunks, r own numbers, S shared ones."""

    chunk: Array  # [n, L] the last one in which |e| left its band; -1: none
    own: Array  # [n, r, L] at its start
    shared: Array  # [C, S] at the start of each chunk


def none(m: Maps, z: Moving) -> Exits:
    """Return the exits before tick 0; z says the shapes."""
    (r, width), n = z.own.shape, m.own_root.shape[1]
    return Exits(jnp.full((n, width), -1), jnp.zeros((n, r, width)), jnp.zeros((len(m.own), len(z.shared))))


def noted(band: Any, exits: Exits, c: Array, peak: Array, z: Moving) -> Exits:
    """Take chunk c into the exits: its peaks [n, L], z at its start."""
    outside = peak > limits(band, peak)
    shared = lax.dynamic_update_index_in_dim(exits.shared, z.shared, c, 0)
    return Exits(jnp.where(outside, c, exits.chunk), jnp.where(outside[:, None], z.own[None], exits.own), shared)


def unsettled(band: Any, m: Maps, each: Chunks, exits: Exits) -> Array:
    """Return the tick after the last exit, [n, L]; 0 where there was none.

    Where rounding is all that took |e| out of the band, the tick is that of the chunk's largest |e|.
    """
    (C, _, r), n = m.own.shape, len(exits.chunk)
    common = jax.vmap(products.same)(m.common, exits.shared).reshape(C, TICKS, n)
    own = jnp.moveaxis(m.own.reshape(C, TICKS, n, r), (2, 3), (0, 1))  # [n, r, C, TICKS]

    def of_signal(given: tuple[Array, ...]) -> Array:
        common, own, chunk, z, limit = given
        at = jnp.maximum(chunk, 0)
        size = jnp.abs(reduce(jnp.add, (own[j][at] * z[j][:, None] for j in range(r)), common[at]))  # [L, TICKS]
        last = jnp.max(jnp.where(size > limit, jnp.arange(TICKS)[None], -1), 1)
        t = lax.cond(
            jnp.all((last >= 0) | (chunk < 0)), lambda: last, lambda: jnp.where(last < 0, jnp.argmax(size, 1), last)
        )
        return jnp.where(chunk < 0, 0, each.start[at] + t + 1).astype(float)

    return lax.map(of_signal, (jnp.moveaxis(common, 2, 0), own, exits.chunk, exits.own, jnp.asarray(band)[:n]))
