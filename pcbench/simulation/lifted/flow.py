"""Take all lanes from an event to the next, 64 ticks at a time: errors are products with z, which stands still so long.

A lane's errors of eight ticks are one product, and their sums are taken from it; at the end of a chunk z is moved. The plant
is moved by itself, so that its numbers do not depend on who observes it; observers that cannot go so are stepped beside.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes, steps
from pcbench.simulation.lifted import moving, sums
from pcbench.simulation.lifted.chunks import BLOCK, TICKS, Chunks, chunks
from pcbench.simulation.lifted.form import PLANT, Form, forms, leaves_of, with_leaves
from pcbench.simulation.lifted.maps import Maps, maps
from pcbench.simulation.lifted.moving import Moving
from pcbench.simulation.problem import Layout, Problem, State

Flow = Callable[[Array, Array, State], State]  # (first tick, tick after the last, state) -> state
Stepped = Callable[[Layout, Array, Array, State], State]  # the same tick by tick, for the observers of a layout
Take = Callable[[Array, Array, Array, Any], Any]  # (tick, ticks left of a chunk, errors of a block, kept) -> kept
All = dict[str, Any]  # by label


def flow(layout: Layout, p: Problem, state: State, stepped: Stepped) -> Flow | None:
    """Return what takes a block of lanes through a flow, `state` that before tick 0; None where all of it is to be stepped."""
    found = forms(layout, p, state) if layout.lifted else ()
    if not found:
        return None
    each, quick = chunks(p, layout.lifted), [form.label for form in found if form.label != PLANT]
    every = {form.label: maps(layout, p, state, form, each) for form in found}
    slow = layout._replace(observers=tuple(o for o in layout.observers if o[0] not in quick))

    def lifted(start: Array, stop: Array, state: State) -> State:
        over = partial(_over_chunks, every, each, (each.before[start], each.before[stop]))
        z = {form.label: moving.taken(form, state) for form in found}
        after, kept = over(partial(sums.score, p), z, {label: moving.sums_of(label, state) for label in quick})
        kept = _bounded(p, over, z, kept) if layout.watch and quick else kept
        out = _beside(slow, stepped, start, stop, _counted(layout, p, found, start, stop, state))
        for form in found:
            out = moving.put(form, out, after[form.label])
        for label in quick:
            out = moving.keep(label, out, kept[label])
        return out

    return lifted


def _over_chunks(every: All, each: Chunks, span: tuple[Array, Array], take: Take, z: All, kept: All) -> tuple[All, All]:
    """Go over some chunks; return z behind them, and what is kept of every observer's errors."""

    def chunk(c: Array, carried: tuple[All, All]) -> tuple[All, All]:
        z, kept = carried
        both = {label: moving.together(z[PLANT], mine) if label != PLANT else mine for label, mine in z.items()}
        kept = {label: _errors(every[label], each, c, both[label], take, mine) for label, mine in kept.items()}
        return {label: _ahead(every[label], c, mine) for label, mine in both.items()}, kept

    end: tuple[All, All] = lax.fori_loop(*span, chunk, (z, kept))
    return end


def _errors(m: Maps, each: Chunks, c: Array, z: Moving, take: Take, kept: Any) -> Any:
    """Take the errors of a chunk, block by block."""
    common = _applied(m.common[c], z.shared)
    n = len(common) // TICKS
    E, ones = (jnp.concatenate([common[:, None], m.own[c]], 1), _with_ones(z.own)) if z.own.size else (common, None)

    def block(i: Array, kept: Any) -> Any:
        rows = lax.dynamic_slice_in_dim(E, i * BLOCK * n, BLOCK * n)
        e = rows if ones is None else rows @ ones
        return take(each.start[c] + i * BLOCK, each.length[c] - i * BLOCK, e.reshape(BLOCK, n, *e.shape[1:]), kept)

    return lax.fori_loop(0, -(-each.length[c] // BLOCK), block, kept)


def _ahead(m: Maps, c: Array, z: Moving) -> Moving:
    """Return what is moved, behind a chunk."""
    shared = _applied(m.shared_after[c], z.shared)
    if not m.own_after.shape[1]:
        return Moving(jnp.zeros(0), shared)
    A = jnp.concatenate([_applied(m.common_after[c], z.shared)[:, None], m.own_after[c]], 1)
    return Moving(A @ _with_ones(z.own), shared)


def _applied(M: Array, shared: Array) -> Array:
    """What is the same in all lanes: M [1, shared]."""
    return M @ jnp.append(1.0, shared)


def _with_ones(own: Array) -> Array:
    return jnp.concatenate([jnp.ones((1, own.shape[1])), own])


def _bounded(p: Problem, over: Callable[[Take, All, All], tuple[All, All]], z: All, kept: All) -> All:
    """Where a peak says that some lane has left its bound, go over the chunks again and note at which tick."""
    bad = {label: watch.first_bad for label, (_, watch) in kept.items()}
    stays = jnp.all(jnp.stack([sums.stays(p, mine) for mine in kept.values()]))
    found = lax.cond(stays, lambda bad: bad, lambda bad: over(partial(sums.first_bad, p), z, bad)[1], bad)
    return {label: (stream, watch._replace(first_bad=found[label])) for label, (stream, watch) in kept.items()}


def _beside(slow: Layout, stepped: Stepped, start: Array, stop: Array, state: State) -> State:
    """The state with those observers stepped that do not go by products; x is not yet moved."""
    if not slow.observers:
        return state

    def of(kept: dict[str, Any]) -> dict[str, Any]:
        return {label: kept[label] for label, _ in slow.observers if label in kept}

    mine = state._replace(memories=of(state.memories), streams=of(state.streams), watches=of(state.watches))
    after = stepped(slow, start, stop, mine)
    return state._replace(
        memories=state.memories | after.memories,
        streams=state.streams | after.streams,
        watches=state.watches | after.watches,
    )


def _counted(layout: Layout, p: Problem, found: tuple[Form, ...], start: Array, stop: Array, state: State) -> State:
    """The state with what observers count, which no error depends on, moved on tick by tick."""
    counting = [form for form in found if form.counted]
    if not counting:
        return state

    def counts(state: State) -> list[list[Any]]:
        return [[leaves_of(state, form.label)[i] for i in form.counted] for form in counting]

    def with_counts(numbers: list[list[Any]]) -> State:
        out = state
        for form, mine in zip(counting, numbers, strict=True):
            leaves = leaves_of(out, form.label)
            for i, a in zip(form.counted, mine, strict=True):
                leaves[i] = a
            out = with_leaves(out, form.label, leaves)
        return out

    def tick(k: Array, numbers: list[list[Any]]) -> list[list[Any]]:
        after = counts(steps.flow(layout, p, k, with_counts(numbers), jnp.zeros(0)))
        return lanes.like(after, numbers, layout.width)

    return with_counts(lax.fori_loop(start, stop, tick, counts(state)))
