"""The last exit from the band: what each lane was at the start of the last chunk with one is kept, and looked at in the end."""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.engine.products import matmul
from pcbench.engine.products.block_maps import Maps, Moving
from pcbench.engine.products.block_metrics import limits
from pcbench.engine.products.blocks import TICKS, Chunks


class Exits(NamedTuple):
    """Of one observer; n signals, C chunks, r own numbers, S shared ones."""

    chunk: Array  # [n, L] the last one in which |e| left its band; -1: none
    own: Array  # [n, r, L] at its start
    shared: Array  # [C, S] at the start of each chunk


def none(m: Maps, z: Moving) -> Exits:
    """Return the exits before tick 0; z says the shapes."""
    (r, width), n = z.own.shape, m.basis.R.shape[1]
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
    common = jnp.moveaxis(jax.vmap(matmul.same)(m.common, exits.shared).reshape(C, TICKS, n), 0, 2)
    own = jnp.moveaxis(m.own.reshape(C, TICKS, n, r), (2, 3, 1), (0, 1, 2))  # [n, r, TICKS, C]
    at = jnp.maximum(exits.chunk, 0)

    def sizes(common: Array, own: Array, at: Array, z: Array) -> Array:
        return jnp.abs(reduce(jnp.add, (own[j][:, at] * z[j][None] for j in range(r)), common[:, at]))  # [TICKS, L]

    size = jax.vmap(sizes, (1, 0, 0, 0))(common, own, at, exits.own)
    outside = size > jnp.asarray(band)[:n, None, None]
    last = jnp.max(jnp.where(outside, jnp.arange(TICKS)[None, :, None], -1), 1)
    known = jnp.all((last >= 0) | (exits.chunk < 0))
    t = lax.cond(known, lambda: last, lambda: jnp.where(last < 0, jnp.argmax(size, 1), last))
    return jnp.where(exits.chunk < 0, 0, each.start[at] + t + 1).astype(float)
