"""What the errors of a chunk leave in streams and watches: `metrics.update` and `metrics.look` of many ticks at once.

Errors e are a list of those of some ticks, [n, L]; beyond a chunk's end they are 0. What all lanes have in common is one lane.

Leaves of a state as rows of numbers, and back.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.engine import lane_array
from pcbench.engine.products.affine_detection import PLANT, Form, leaves_of, with_leaves
from pcbench.engine.products.block_maps import Moving
from pcbench.simulation.metrics import ErrorSums, SettlingState
from pcbench.simulation.types import GridPointParams, State


def sizes(e: list[Array], before: Array) -> Array:
    """Take errors into sizes [n, L]: the sum of |e| as real part, the peak as imaginary one.

    One array, for an array is computed in one loop: of two, each would go through all errors again.
    """
    each = [jnp.abs(tick) for tick in e]
    return lax.complex(before.real + _fold_pairwise(jnp.add, each), _larger(before.imag, _fold_pairwise(_larger, each)))


def squares(e: list[Array], before: Array) -> Array:
    """Take errors into the sum of e^2, [n, L]."""
    return before + _fold_pairwise(jnp.add, [tick * tick for tick in e])


def stays(p: GridPointParams, stream: ErrorSums, watch: SettlingState) -> Array:
    """Say whether no lane can have left its bound for the first time: their peaks are of all ticks of a window up to now."""
    return jnp.all(jnp.all(stream.peak <= limits(p.bound, stream.peak), 0) | (watch.first_bad >= 0))


def first_bad(p: GridPointParams, k: Array, left: Array, e: list[Array], bad: Array) -> Array:
    """Return the first tick at which an error is not finite or beyond the bound, or -1, with the `left` ticks from k on."""
    bound = limits(p.bound, e[0])
    for t, tick in enumerate(e):
        out = (t < left) & (bad < 0) & ~jnp.all(jnp.abs(tick) <= bound, 0)
        bad = jnp.where(out, (k + t).astype(float), bad)
    return bad


def update_settling(p: GridPointParams, k: Array, e: list[Array], watch: SettlingState) -> SettlingState:
    """Note the ticks after exits from the band, and how long after a jump of the unknown input."""
    band, unsettled, recovery = limits(p.band, e[0]), watch.unsettled, watch.recovery
    for t, tick in enumerate(e):
        outside = jnp.abs(tick) > band
        unsettled = jnp.where(outside, (k + t + 1).astype(float), unsettled)
        if p.jumps.shape[0]:
            since = jnp.min(jnp.where(p.jumps <= k + t, k + t - p.jumps, k + t))
            after = outside & jnp.any(p.jumps <= k + t)
            recovery = jnp.where(after, jnp.maximum(recovery, since + 1.0), recovery)
    return watch._replace(unsettled=unsettled, recovery=recovery)


def limits(of_signals: PyTree, like: Array) -> Array:
    """A limit of each signal, [n, 1]."""
    return jnp.asarray(of_signals)[: like.shape[0], None]


def _larger(a: Array, b: Array) -> Array:
    """The larger of sizes, one instruction: their bits are ordered as they are, and NaN is above all of them."""
    bits = [lax.bitcast_convert_type(size, jnp.int64) for size in (a, b)]
    return lax.bitcast_convert_type(jnp.maximum(*bits), a.dtype)


def _fold_pairwise(way: Callable[[Array, Array], Array], parts: list[Array]) -> Array:
    """Fold arrays two by two."""
    while len(parts) > 1:
        parts = [way(*parts[i : i + 2]) for i in range(0, len(parts), 2)]
    return parts[0]


Sums = tuple[Any, Any]  # (Stream, Watch), arrays [n, L]; where all lanes have them in common, L = 1


def extract_moving(form: Form, state: State) -> Moving:
    """Return what a form moves of a state."""
    each = leaves_of(state, form.label)
    own = [lane_array.join(each[i]) for i in _form_leaves(form, form.own)]
    shared = [jnp.ravel(each[i]) for i in _form_leaves(form, form.shared)]
    rows = [a.reshape(-1, a.shape[-1]) for a in own]
    return Moving(jnp.concatenate(rows) if rows else jnp.zeros((0, 1)), jnp.concatenate([jnp.zeros(0), *shared]))


def concat_moving(plant: Moving, memory: Moving) -> Moving:
    """Return x and an observer's numbers as one."""
    rows = [part for part in (plant.own, memory.own) if part.size]
    own = jnp.concatenate(rows) if rows else memory.own
    return Moving(own, jnp.concatenate([plant.shared, memory.shared]))


def put(form: Form, state: State, z: Moving) -> State:
    """Return the state with other numbers."""
    each = leaves_of(state, form.label)
    for numbers, which in ((z.own, form.own), (z.shared, form.shared)):
        at = 0
        for i in _form_leaves(form, which):
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


def _form_leaves(form: Form, which: tuple[int, ...]) -> list[int]:
    """Leaves that a form moves: x is the plant's alone."""
    return [i for i in which if i or form.label == PLANT]


def _like(new: Array, old: PyTree) -> PyTree:
    """An array with lanes last in the form of what it replaces."""
    if not lane_array.is_lanes(old):
        return new.reshape(jnp.shape(old))
    return lane_array.table(lane_array.split(new)) if old.rows is not None else lane_array.split(new)
