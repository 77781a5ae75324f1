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

    leaves: list[PyTree]
    matrix: Array  # [M, L]


class Place(NamedTuple):
    """The rows of a leaf's entries, one after another; an entry of a table takes as many rows as the table."""

    first: int
    shape: tuple[int, ...]
    rows: int | None
    dtype: Any


class Packing(NamedTuple):
    """How memories are packed: leaves that `flow` changes stay arrays (place None), all others are rows of one array [M, L]."""

    tree: PyTree
    places: list[Place | None]

    def unpack(self, memory: PackedMemory) -> PyTree:
        """Return the unpacked memories."""
        unpacked = iter(memory.leaves)
        leaves = [next(unpacked) if place is None else _unpack_leaf(memory.matrix, place) for place in self.places]
        return jax.tree.unflatten(self.tree, leaves)

    def repack(self, memories: PyTree, memory: PackedMemory) -> PackedMemory:
        """Return the packed memories with the leaves that a flow has changed."""
        return memory._replace(leaves=self._flow_leaves(self._leaves(memories)))

    def pack(self, memories: PyTree) -> PackedMemory:
        """Return packed memories."""
        leaves = self._leaves(memories)
        packed_leaves = [leaf for leaf, place in zip(leaves, self.places, strict=True) if place is not None]
        rows = [jnp.atleast_2d(entry).astype(float) for leaf in packed_leaves for entry in leaf.parts.flat]
        return PackedMemory(self._flow_leaves(leaves), jnp.concatenate(rows) if rows else jnp.zeros((0, 1)))

    def _leaves(self, memories: PyTree) -> list[PyTree]:
        return jax.tree.leaves(memories, is_leaf=lane_array.is_lanes)

    def _flow_leaves(self, leaves: list[PyTree]) -> list[PyTree]:
        return [leaf for leaf, place in zip(leaves, self.places, strict=True) if place is None]


def find_packing(flow: Callable[[PyTree], PyTree], memories: PyTree) -> Packing:
    """Return the packing for memories moved by `flow` (memories -> memories), which is traced to find the leaves it changes."""
    unchanged: list[bool] = []

    def trace_flow(old_tree: PyTree) -> int:
        pairs = zip(
            *(jax.tree.leaves(tree, is_leaf=lane_array.is_lanes) for tree in (flow(old_tree), old_tree)), strict=True
        )
        unchanged.extend(new is old for new, old in pairs)
        return 0

    jax.eval_shape(trace_flow, memories)
    leaves, tree = jax.tree.flatten(memories, is_leaf=lane_array.is_lanes)
    places: list[Place | None] = []
    rows = 0
    for leaf, is_packed in zip(leaves, unchanged, strict=True):
        if is_packed and lane_array.is_lanes(leaf) and leaf.parts.size:
            places.append(Place(rows, leaf.parts.shape, leaf.rows, leaf.dtype))
            rows += leaf.parts.size * (leaf.rows or 1)
        else:
            places.append(None)
    return Packing(tree, places)


def pick(memory: PackedMemory, lane: Array) -> PackedMemory:
    """Return the lanes with the numbers `lane` [K]."""
    return PackedMemory(lane_array.pick(memory.leaves, lane), memory.matrix.at[:, lane].get(mode="clip"))


def put_back(memory: PackedMemory, lanes: PackedMemory, lane: Array) -> PackedMemory:
    """Write extracted lanes back to their places; a number beyond the last lane is ignored."""
    matrix = memory.matrix.at[:, lane].set(lanes.matrix, mode="drop")
    return PackedMemory(lane_array.put_back(memory.leaves, lanes.leaves, lane), matrix)


def _unpack_leaf(matrix: Array, p: Place) -> LaneArray:
    count, size = math.prod(p.shape), p.rows or 1
    blocks = [matrix[p.first + i * size : p.first + (i + 1) * size].astype(p.dtype) for i in range(count)]
    return lane_array.lanes_of(p.shape, blocks if p.rows else [block[0] for block in blocks], p.rows)
