"""Take all lanes from an event to the next by the products of `maps`, and what their errors leave in streams and watches.

Every metric is that of `metrics.update` and `metrics.look`, over the same ticks; sums are taken in another order.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes, steps
from pcbench.simulation.lifted.chunks import BLOCK, Chunks, chunks
from pcbench.simulation.lifted.form import Form, forms, leaves_of, with_leaves
from pcbench.simulation.lifted.maps import Maps, maps
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
        first, last = each.before[start], each.before[stop]
        after = _counted(layout, p, found, start, stop, state)
        for form in found:
            mine = products[form.label]
            begun, sums = _moving(form, state), _sums(form, state)
            z, sums = lax.fori_loop(first, last, partial(_chunk, p, form, mine, each), (begun, sums))
            after = _put(form, after, z, _bounded(p, mine, each, first, last, begun, sums))
        return after

    return lifted


def _chunk(p: Problem, form: Form, m: Maps, each: Chunks, c: Array, carried: tuple[Moving, Sums]) -> tuple[Moving, Sums]:
    """Take one chunk: the errors of its ticks into the sums, block by block, and z behind it."""
    z, sums = carried
    a, E = _errors(m, c, z.shared)

    def block(i: Array, sums: Sums) -> Sums:
        return _scored(p, each.start[c] + i * BLOCK, _block(form.signals, a, E, z.own, i), sums)

    sums = lax.fori_loop(0, -(-each.length[c] // BLOCK), block, sums)
    return _ahead(m, c, z), sums


def _ahead(m: Maps, c: Array, z: Moving) -> Moving:
    """What is moved, behind a chunk."""
    shared = jnp.append(1.0, m.shared_after[c] @ z.shared)
    if z.own.ndim == 1:
        return Moving(z.own, shared)
    ahead = jnp.concatenate([(m.common_after[c] @ z.shared)[:, None], m.own_after[c]], 1)
    ones = jnp.zeros((1, ahead.shape[1])).at[0, 0].set(1.0)
    return Moving(jnp.concatenate([ones, ahead]) @ z.own, shared)


def _errors(m: Maps, c: Array, shared: Array) -> tuple[Array, Array]:
    """The errors of a chunk's ticks as a product: a [TICKS n], and [a, E] [TICKS n, 1 + r]."""
    a = m.common[c] @ shared
    return a, jnp.concatenate([a[:, None], m.own[c]], 1)


def _block(n: int, a: Array, E: Array, own: Array, i: Array) -> Array:
    """The errors of the ticks of block i, [BLOCK, n, L]; without lanes [BLOCK, n]."""
    if own.ndim == 1:
        return lax.dynamic_slice_in_dim(a, i * BLOCK * n, BLOCK * n).reshape(BLOCK, n)
    return (lax.dynamic_slice_in_dim(E, i * BLOCK * n, BLOCK * n) @ own).reshape(BLOCK, n, -1)


def _scored(p: Problem, k: Array, e: Array, sums: Sums) -> Sums:
    """Take the errors of a block [BLOCK, n] or [BLOCK, n, L] from tick k into the sums; those beyond a chunk's end are 0."""
    stream, watch = sums
    size = jnp.abs(e)
    stream = Stream(
        stream.absolute + _folded(jnp.add, list(size)),
        stream.square + _folded(jnp.add, list(e * e)),
        jnp.maximum(stream.peak, _folded(jnp.maximum, list(size))),
    )
    return stream, watch and _watched(p, k, size, watch)


def _watched(p: Problem, k: Array, size: Array, watch: Watch) -> Watch:
    """Note at every tick of a block what left its band, as `metrics.look` does."""
    band, unsettled, recovery = _limits(p.band, size[0]), watch.unsettled, watch.recovery
    for t in range(BLOCK):
        outside = size[t] > band
        unsettled = jnp.where(outside, (k + t + 1).astype(float), unsettled)
        if p.jumps.shape[0]:
            since = jnp.min(jnp.where(p.jumps <= k + t, k + t - p.jumps, k + t))
            after = jnp.any(p.jumps <= k + t)
            recovery = jnp.where(outside & after, jnp.maximum(recovery, since + 1.0), recovery)
    return watch._replace(unsettled=unsettled, recovery=recovery)


def _bounded(p: Problem, m: Maps, each: Chunks, first: Array, last: Array, z: Moving, sums: Sums) -> Sums:
    """Where a peak says that a lane has left its bound, go over the chunks again and note when."""
    stream, watch = sums
    if not watch:
        return sums
    n = stream.peak.shape[0]
    bound = _limits(p.bound, stream.peak)

    def chunk(c: Array, carried: tuple[Moving, Array]) -> tuple[Moving, Array]:
        z, bad = carried
        a, E = _errors(m, c, z.shared)

        def block(i: Array, bad: Array) -> Array:
            e = _block(n, a, E, z.own, i)
            for t in range(BLOCK):
                there = i * BLOCK + t < each.length[c]
                out = there & (bad < 0) & ~jnp.all(jnp.abs(e[t]) <= bound, 0)
                bad = jnp.where(out, (each.start[c] + i * BLOCK + t).astype(float), bad)
            return bad

        return _ahead(m, c, z), lax.fori_loop(0, -(-each.length[c] // BLOCK), block, bad)

    def look(bad: Array) -> Array:
        return lax.fori_loop(first, last, chunk, (z, bad))[1]

    inside = jnp.all(jnp.all(stream.peak <= bound, 0) | (watch.first_bad >= 0))
    return stream, watch._replace(first_bad=lax.cond(inside, lambda bad: bad, look, watch.first_bad))


def _limits(limits: Any, like: Array) -> Array:
    """A limit of each signal, [n] or [n, 1] for [n, L]."""
    return jnp.asarray(limits)[: like.shape[0]].reshape(-1, *(1 for _ in like.shape[1:]))


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
