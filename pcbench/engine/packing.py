"""Packed memories between events: all leaves that flow does not change are stored in one array.

With random schedules an event extracts a few lanes from every array and writes them back. Most of a memory is changed by jumps
only. Packed, it needs two operations in total instead of two per entry. Integers and booleans are stored as floats, which is
exact up to 2^53.
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
    """The leaves of a memory: those that flow changes, unchanged, and the others packed."""

    moving: list[PyTree]
    still: Array  # [M, L]


class Place(NamedTuple):
    """The rows of a leaf's entries, one after another; an entry of a table takes as many rows as the table."""

    first: int
    shape: tuple[int, ...]
    rows: int | None
    kind: Any


class Packing(NamedTuple):
    """How memories are packed: leaves that `flow` changes stay arrays (place None), all others are rows of one array [M, L]."""

    tree: PyTree
    places: list[Place | None]

    def whole(self, kept: PackedMemory) -> PyTree:
        """Return the unpacked memories."""
        moving = iter(kept.moving)
        leaves = [next(moving) if place is None else _unpack_leaf(kept.still, place) for place in self.places]
        return jax.tree.unflatten(self.tree, leaves)

    def moved(self, memories: PyTree, kept: PackedMemory) -> PackedMemory:
        """Return the packed memories with the leaves that a flow has changed."""
        return kept._replace(moving=self._moving(self._leaves(memories)))

    def pack(self, memories: PyTree) -> PackedMemory:
        """Return packed memories."""
        leaves = self._leaves(memories)
        packed = [leaf for leaf, place in zip(leaves, self.places, strict=True) if place is not None]
        rows = [jnp.atleast_2d(entry).astype(float) for leaf in packed for entry in leaf.parts.flat]
        return PackedMemory(self._moving(leaves), jnp.concatenate(rows) if rows else jnp.zeros((0, 1)))

    def _leaves(self, memories: PyTree) -> list[PyTree]:
        return jax.tree.leaves(memories, is_leaf=lane_array.is_lanes)

    def _moving(self, leaves: list[PyTree]) -> list[PyTree]:
        return [leaf for leaf, place in zip(leaves, self.places, strict=True) if place is None]


def packing(flow: Callable[[PyTree], PyTree], memories: PyTree) -> Packing:
    """Return the packing for memories moved by `flow` (memories -> memories), which is traced to find the leaves it changes."""
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
    """Return the lanes with the numbers `lane` [K]."""
    return PackedMemory(lane_array.pick(kept.moving, lane), kept.still.at[:, lane].get(mode="clip"))


def put_back(kept: PackedMemory, some: PackedMemory, lane: Array) -> PackedMemory:
    """Write extracted lanes back to their places; a number beyond the last lane is ignored."""
    still = kept.still.at[:, lane].set(some.still, mode="drop")
    return PackedMemory(lane_array.put_back(kept.moving, some.moving, lane), still)


def _unpack_leaf(still: Array, p: Place) -> LaneArray:
    each, size = math.prod(p.shape), p.rows or 1
    blocks = [still[p.first + i * size : p.first + (i + 1) * size].astype(p.kind) for i in range(each)]
    return lane_array.lanes_of(p.shape, blocks if p.rows else [block[0] for block in blocks], p.rows)
