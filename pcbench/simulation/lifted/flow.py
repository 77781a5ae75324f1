"""Take all lanes from an event to the next by the products of `maps`, and what their errors leave in streams and watches.

Every metric is that of `metrics.update` and `metrics.look`, over the same ticks; sums are taken in another order.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes, steps
from pcbench.simulation.lifted.chunks import TICKS, Chunks, chunks
from pcbench.simulation.lifted.form import Form, forms, leaves_of, with_leaves
from pcbench.simulation.lifted.maps import maps
from pcbench.simulation.metrics import Stream, Watch
from pcbench.simulation.problem import Layout, Problem, State

Flow = Callable[[Array, Array, State], State]  # (first tick, tick after the last, state) -> state
Sums = tuple[Stream, Any]  # with a watch, or without; numbers [n] or [n, L]


class Moving(NamedTuple):
    """Of one observer and its plant between two chunks: r own numbers of each lane, S shared ones."""

    own: Array  # [1 + r, L], a row of ones first; of no lane [1]
    shared: Array  # [1 + S], 1 first


def flow(layout: Layout, p: Problem, state: State) -> Flow | None:
    """Return what takes a block of lanes through its flows; None where it is to be stepped. `state` is that before tick 0."""
    found = forms(layout, p, state) if layout.lifted else ()
    if not found:
        return None
    each = chunks(p, layout.lifted)
    products = {form.label: maps(layout, p, state, form, each) for form in found}

    def lifted(start: Array, stop: Array, state: State) -> State:
        def chunk(c: Array, carried: Any) -> Any:
            return {form.label: _chunk(layout, p, form, products[form.label][c], each, c, *carried[form.label]) for form in found}

        carried = {form.label: (_moving(form, state), _sums(form, state)) for form in found}
        carried = lax.fori_loop(each.before[start], each.before[stop], chunk, carried)
        after = _counted(layout, p, found, start, stop, state)
        for form in found:
            after = _put(form, after, *carried[form.label])
        return after

    return lifted


def _chunk(layout: Layout, p: Problem, form: Form, M: Array, each: Chunks, c: Array, z: Moving, sums: Sums) -> Any:
    """Take one chunk: the errors of its ticks into the sums, and z behind it."""
    r, errors = z.own.shape[0] - 1, TICKS * form.signals
    common = M[:, jnp.r_[0, 1 + r : M.shape[1]]] @ z.shared
    shared = jnp.append(1.0, common[errors + r :])
    if not form.own:
        return Moving(z.own, shared), _scored(p, each, c, common[:errors].reshape(TICKS, -1), sums)
    own = jnp.concatenate([common[: errors + r, None], M[: errors + r, 1 : 1 + r]], 1)
    ones = jnp.zeros((1, 1 + r)).at[0, 0].set(1.0)
    out = jnp.concatenate([own[:errors], ones, own[errors:]]) @ z.own
    e = out[:errors].reshape(TICKS, form.signals, -1)
    return Moving(out[errors:], shared), _scored(p, each, c, e, sums)


def _scored(p: Problem, each: Chunks, c: Array, e: Array, sums: Sums) -> Sums:
    """Take the errors [TICKS, n] or [TICKS, n, L] of a chunk into the sums; a tick that is not there has the error 0."""
    stream, watch = sums
    size = jnp.abs(e)
    peak = _folded(jnp.maximum, list(size))
    stream = Stream(
        stream.absolute + _folded(jnp.add, list(size)),
        stream.square + _folded(jnp.add, list(e * e)),
        jnp.maximum(stream.peak, peak),
    )
    return stream, watch and _watched(p, each, c, size, peak, watch)


def _watched(p: Problem, each: Chunks, c: Array, size: Array, peak: Array, watch: Watch) -> Watch:
    """Look at every tick for what left its band, and for what left its bound where the peak says that something did."""
    n, k, length = size.shape[1], each.start[c], each.length[c]
    wide = (n, *(1 for _ in size.shape[2:]))
    band, bound = (jnp.asarray(a)[:n].reshape(wide) for a in (p.band, p.bound))
    unsettled, recovery = watch.unsettled, watch.recovery
    for t in range(TICKS):
        outside = size[t] > band
        unsettled = jnp.where(outside, (k + t + 1).astype(float), unsettled)
        if p.jumps.shape[0]:
            since = jnp.min(jnp.where(p.jumps <= k + t, k + t - p.jumps, k + t))
            after = jnp.any(p.jumps <= k + t)
            recovery = jnp.where(outside & after, jnp.maximum(recovery, since + 1.0), recovery)

    def first(bad: Array) -> Array:
        for t in reversed(range(TICKS)):
            good = jnp.all(size[t] <= bound, 0) | (t >= length)
            found = jnp.where(good, -1.0 if t == TICKS - 1 else found, (k + t).astype(float))
        return jnp.where(bad >= 0, bad, found)

    inside = jnp.all(peak <= bound)
    return Watch(unsettled, recovery, lax.cond(inside, lambda bad: bad, first, watch.first_bad))


def _folded(way: Callable[[Array, Array], Array], parts: list[Array]) -> Array:
    """Fold arrays two by two."""
    while len(parts) > 1:
        parts = [way(*parts[i : i + 2]) for i in range(0, len(parts), 2)]
    return parts[0]


def _moving(form: Form, state: State) -> Moving:
    """What a flow moves of one observer and its plant."""
    each = leaves_of(state, form.label)
    own = [lanes.join(each[i]) for i in form.own]
    rows = [a.reshape(-1, a.shape[-1]) for a in own]
    ones = [jnp.ones((1, rows[0].shape[1]))] if rows else [jnp.ones(1)]
    return Moving(jnp.concatenate([*ones, *rows]), jnp.concatenate([jnp.ones(1), *(jnp.ravel(each[i]) for i in form.shared)]))


def _put(form: Form, state: State, z: Moving, sums: Sums) -> State:
    """Put back what a flow has moved, and its sums."""
    each = leaves_of(state, form.label)
    for numbers, which in ((z.own[1:], form.own), (z.shared[1:], form.shared)):
        at = 0
        for i in which:
            size = math.prod(each[i].shape)
            mine = numbers[at : at + size].reshape(*each[i].shape, *numbers.shape[1:])
            each[i] = _like(mine, each[i])
            at += size
    stream, watch = sums
    state = with_leaves(state, form.label, each)
    state = state._replace(streams=state.streams | {form.label: _as(stream, state.streams[form.label])})
    if not watch:
        return state
    return state._replace(watches=state.watches | {form.label: _as(watch, state.watches[form.label])})


def _sums(form: Form, state: State) -> Sums:
    """Streams and watch of one observer, as arrays."""
    kept = state.streams[form.label], state.watches.get(form.label, ())
    return jax.tree.map(lambda a: lanes.join(a) if lanes.is_lanes(a) else a, kept, is_leaf=lanes.is_lanes)


def _as(arrays: Any, there: Any) -> Any:
    return jax.tree.map(lambda old, new: _like(new, old), there, arrays, is_leaf=lanes.is_lanes)


def _like(new: Array, old: Any) -> Any:
    """An array with lanes last in the form of what it replaces."""
    if not lanes.is_lanes(old):
        return new
    return lanes.table(lanes.split(new)) if old.rows is not None else lanes.split(new)


def _counted(layout: Layout, p: Problem, found: tuple[Form, ...], start: Array, stop: Array, state: State) -> State:
    """The state with what its observers count, which no error depends on, moved on tick by tick."""
    if not any(form.counted for form in found):
        return state

    def with_counts(counts: dict[str, list[Any]]) -> State:
        out = state
        for form in found:
            each = leaves_of(state, form.label)
            for i, a in zip(form.counted, counts[form.label], strict=True):
                each[i] = a
            out = with_leaves(out, form.label, each)
        return out

    def counts(state: State) -> dict[str, list[Any]]:
        return {form.label: [leaves_of(state, form.label)[i] for i in form.counted] for form in found}

    def tick(k: Array, carried: dict[str, list[Any]]) -> dict[str, list[Any]]:
        after = counts(steps.flow(layout, p, k, with_counts(carried), jnp.zeros(0)))
        return lanes.like(after, carried, layout.width)

    return with_counts(lax.fori_loop(start, stop, tick, counts(state)))
