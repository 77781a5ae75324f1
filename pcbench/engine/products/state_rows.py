"""Leaves of a state as rows of numbers, and back."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from pcbench.engine import lane_array
from pcbench.engine.products.affine_detection import PLANT, Form, leaves_of, with_leaves
from pcbench.engine.products.block_maps import Moving
from pcbench.simulation.types import State

Sums = tuple[Any, Any]  # (Stream, Watch), arrays [n, L]; where all lanes have them in common, L = 1


def taken(form: Form, state: State) -> Moving:
    """Return what a form moves of a state."""
    each = leaves_of(state, form.label)
    own = [lane_array.join(each[i]) for i in _mine(form, form.own)]
    shared = [jnp.ravel(each[i]) for i in _mine(form, form.shared)]
    rows = [a.reshape(-1, a.shape[-1]) for a in own]
    return Moving(jnp.concatenate(rows) if rows else jnp.zeros((0, 1)), jnp.concatenate([jnp.zeros(0), *shared]))


def together(plant: Moving, memory: Moving) -> Moving:
    """Return x and an observer's numbers as one."""
    rows = [part for part in (plant.own, memory.own) if part.size]
    own = jnp.concatenate(rows) if rows else memory.own
    return Moving(own, jnp.concatenate([plant.shared, memory.shared]))


def put(form: Form, state: State, z: Moving) -> State:
    """Return the state with other numbers."""
    each = leaves_of(state, form.label)
    for numbers, which in ((z.own, form.own), (z.shared, form.shared)):
        at = 0
        for i in _mine(form, which):
            size = math.prod(each[i].shape)
            each[i] = _like(numbers[at : at + size].reshape(*each[i].shape, *numbers.shape[1:]), each[i])
            at += size
    return with_leaves(state, form.label, each)


def sums_of(label: str, state: State) -> Sums:
    """Return streams and watch of one observer, as arrays with lanes."""
    kept = state.streams[label], state.watches.get(label, ())
    arrays: Sums = jax.tree.map(
        lambda a: lane_array.join(a) if lane_array.is_lanes(a) else a[..., None], kept, is_leaf=lane_array.is_lanes
    )
    return arrays


def keep(label: str, state: State, sums: Sums) -> State:
    """Return the state with other streams and another watch of one observer."""
    before = state.streams[label], state.watches.get(label, ())
    stream, watch = jax.tree.map(lambda old, new: _like(new, old), before, sums, is_leaf=lane_array.is_lanes)
    watches = state.watches | {label: watch} if watch else state.watches
    return state._replace(streams=state.streams | {label: stream}, watches=watches)


def _mine(form: Form, which: tuple[int, ...]) -> list[int]:
    """Leaves that a form moves: x is the plant's alone."""
    return [i for i in which if i or form.label == PLANT]


def _like(new: Array, old: Any) -> Any:
    """An array with lanes last in the form of what it replaces."""
    if not lane_array.is_lanes(old):
        return new.reshape(jnp.shape(old))
    return lane_array.table(lane_array.split(new)) if old.rows is not None else lane_array.split(new)
