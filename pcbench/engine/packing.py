"""Memories as they are kept between events: what flow leaves alone lies together, in one array.

An event on schedules of their own takes a few lanes out of every array and puts them back. Most of a memory is changed by jumps
only; packed, it costs two operations in all instead of two for each entry. Whole numbers and truth values are kept as floats,
which hold them exactly up to 2^53.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import PyTree

from pcbench.engine import lane_array
from pcbench.engine.lane_array import LaneArray


class PackedMemory(NamedTuple):
    """The leaves of a memory: those that flow moves, as they are, and the others packed."""

    moving: list[PyTree]
    still: Array  # [M, L]


class Place(NamedTuple):
    """Where a leaf's entries are kept, one after the other; a table's entry takes as many rows as it has."""

    first: int
    shape: tuple[int, ...]
    rows: int | None
    kind: Any


class Packing(NamedTuple):
    """How memories are packed: leaves that `flow` changes stay arrays (place None), all others are rows of one array [M, L]."""

    tree: PyTree
    places: list[Place | None]

    def whole(self, kept: PackedMemory) -> PyTree:
        """Unpack: return the memories."""
        moving = iter(kept.moving)
        leaves = [next(moving) if place is None else _unpack_leaf(kept.still, place) for place in self.places]
        return jax.tree.unflatten(self.tree, leaves)

    def moved(self, memories: PyTree, kept: PackedMemory) -> PackedMemory:
        """Return what is packed, with the leaves that a flow has changed."""
        return kept._replace(moving=self._moving(self._leaves(memories)))

    def pack(self, memories: PyTree) -> PackedMemory:
        """Pack memories."""
        leaves = self._leaves(memories)
        packed = [leaf for leaf, place in zip(leaves, self.places, strict=True) if place is not None]
        rows = [jnp.atleast_2d(entry).astype(float) for leaf in packed for entry in leaf.parts.flat]
        return PackedMemory(self._moving(leaves), jnp.concatenate(rows) if rows else jnp.zeros((0, 1)))

    def _leaves(self, memories: PyTree) -> list[PyTree]:
        return jax.tree.leaves(memories, is_leaf=lane_array.is_lanes)

    def _moving(self, leaves: list[PyTree]) -> list[PyTree]:
        return [leaf for leaf, place in zip(leaves, self.places, strict=True) if place is None]


def packing(flow: Callable[[PyTree], PyTree], memories: PyTree) -> Packing:
    """Return how to keep memories that `flow` (memories -> memories) moves: it is traced to see what it leaves alone."""
    alone: list[bool] = []

    def probe(before: PyTree) -> int:
        pairs = zip(
            *(jax.tree.leaves(tree, is_leaf=lane_array.is_lanes) for tree in (flow(before), before)), strict=True
        )
        alone.extend(new is old for new, old in pairs)
        return 0

    jax.eval_shape(probe, memories)
    leaves, tree = jax.tree.flatten(memories, is_leaf=lane_array.is_lanes)
    places: list[Place | None] = []
    rows = 0
    for leaf, left in zip(leaves, alone, strict=True):
        if left and lane_array.is_lanes(leaf) and leaf.parts.size:
            places.append(Place(rows, leaf.parts.shape, leaf.rows, leaf.dtype))
            rows += leaf.parts.size * (leaf.rows or 1)
        else:
            places.append(None)
    return Packing(tree, places)


def pick(kept: PackedMemory, lane: Array) -> PackedMemory:
    """Take some lanes out; `lane` [K] holds their numbers."""
    return PackedMemory(lane_array.pick(kept.moving, lane), kept.still.at[:, lane].get(mode="clip"))


def put_back(kept: PackedMemory, some: PackedMemory, lane: Array) -> PackedMemory:
    """Put lanes taken out back in their places; a number beyond the last lane is of none."""
    still = kept.still.at[:, lane].set(some.still, mode="drop")
    return PackedMemory(lane_array.put_back(kept.moving, some.moving, lane), still)


def _unpack_leaf(still: Array, p: Place) -> LaneArray:
    each, size = math.prod(p.shape), p.rows or 1
    blocks = [still[p.first + i * size : p.first + (i + 1) * size].astype(p.kind) for i in range(each)]
    return lane_array.lanes_of(p.shape, blocks if p.rows else [block[0] for block in blocks], p.rows)
