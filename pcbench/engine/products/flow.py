"""Take all lanes from an event to the next, 64 ticks at a time: errors are products with z, which stands still so long.

A lane's errors of some ticks are taken at once, and their sums from them; at the end of a chunk z is moved. The plant
is moved by itself, so that its numbers do not depend on who observes it; observers that cannot go so are stepped beside.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.engine import lane_array, steps
from pcbench.engine.products import block_metrics, matmul
from pcbench.engine.products.affine_detection import PLANT, Form, forms, leaves_of, with_leaves
from pcbench.engine.products.block_maps import Maps, Moving, every_map
from pcbench.engine.products.matmul import BLOCK, TICKS, WRITTEN, Chunks, chunks
from pcbench.simulation.metrics import ErrorSums
from pcbench.simulation.types import GridPointParams, Layout, State

Flow = Callable[[Array, Array, State], State]  # (first tick, tick after the last, state) -> state
Stepped = Callable[[Layout, Array, Array, State], State]  # the same tick by tick, for the observers of a layout
Take = Callable[
    [Array, Array, list[Array], Any], Any
]  # (tick, ticks left of a chunk, e [n, L] from there, kept) -> kept
All = dict[str, Any]  # by label
Visit = Callable[[str, Array, Moving, Any], Any]  # (label, chunk, z at its start, kept) -> kept


def flow(
    layout: Layout, p: GridPointParams, state: State, stepped: Stepped, given: dict[str, Maps] | None = None
) -> Flow:
    """Return what takes a block of lanes from an event to the next, `state` that before tick 0: by products, what can be.

    Maps of all that can are `given`, or made here.
    """
    found = forms(layout, p, state) if layout.lifted else ()
    if not found:
        return partial(stepped, layout)
    each, quick = chunks(p, layout.lifted), [form.label for form in found if form.label != PLANT]
    every = given or every_map(layout, p)
    slow = layout._replace(observers=tuple(o for o in layout.observers if o[0] not in quick))

    def lifted(start: Array, stop: Array, state: State) -> State:
        over = partial(_over_chunks, every, (each.before[start], each.before[stop]))
        z = {form.label: block_metrics.extract_moving(form, state) for form in found}
        kept = {label: block_metrics.sums_of(label, state) for label in quick}
        after, kept = over(partial(_accumulate_errors, p, every, each), z, kept)
        kept = _find_divergence(p, over, partial(_blocks, every, each), z, kept) if layout.watch and quick else kept
        out = _step_remaining(slow, stepped, start, stop, _step_counters(layout, p, found, start, stop, state))
        for form in found:
            out = block_metrics.put(form, out, after[form.label])
        for label in quick:
            out = block_metrics.keep(label, out, kept[label])
        return out

    return lifted


def _joint_states(z: All) -> All:
    """By label, what an observer's errors depend on: its own numbers and the plant's."""
    return {label: block_metrics.concat_moving(z[PLANT], mine) if label != PLANT else mine for label, mine in z.items()}


def _over_chunks(every: All, span: tuple[Array, Array], visit: Visit, z: All, kept: All) -> tuple[All, All]:
    """Go over some chunks; return z behind them, and what is kept of every observer's errors."""

    def chunk(c: Array, carried: tuple[All, All]) -> tuple[All, All]:
        z, kept = carried
        both = _joint_states(z)
        kept = {label: visit(label, c, both[label], mine) for label, mine in kept.items()}
        return {label: _advance(every[label], c, mine) for label, mine in both.items()}, kept

    end: tuple[All, All] = lax.fori_loop(*span, chunk, (z, kept))
    return end


def _accumulate_errors(
    p: GridPointParams, every: All, each: Chunks, label: str, c: Array, z: Moving, kept: PyTree
) -> PyTree:
    """Take the errors of a chunk into streams and watch."""
    stream, watch = kept

    def take(k: Array, left: Array, e: list[Array], kept: PyTree) -> PyTree:
        sizes, square, watch = kept
        looked = block_metrics.update_settling(p, k, e, watch) if watch else watch
        return block_metrics.sizes(e, sizes), block_metrics.squares(e, square), looked

    kept = lax.complex(stream.absolute, stream.peak), stream.square, watch
    sizes, square, watch = _blocks(every, each, take, label, c, z, kept)
    return ErrorSums(sizes.real, square, sizes.imag), watch


def _blocks(every: All, each: Chunks, take: Take, label: str, c: Array, z: Moving, kept: PyTree) -> PyTree:
    """Take the errors of a chunk, block by block."""
    m = every[label]
    common = matmul.same(m.common[c], z.shared)
    n, ticks = len(common) // TICKS, WRITTEN if matmul.few(len(z.own)) else BLOCK
    E = jnp.concatenate([common[:, None], m.own[c]], 1)

    def block(i: Array, kept: PyTree) -> PyTree:
        rows = lax.dynamic_slice_in_dim(E, i * ticks * n, ticks * n)
        if matmul.few(len(z.own)):  # tick by tick: what is cut out of a whole would be kept
            e = [matmul.of_lanes(row[:, 1:], row[:, 0], z.own) for row in rows.reshape(ticks, n, -1)]
        else:
            e = list(matmul.of_lanes(rows[:, 1:], rows[:, 0], z.own).reshape(ticks, n, -1))
        return take(each.start[c] + i * ticks, each.length[c] - i * ticks, e, kept)

    return lax.fori_loop(0, -(-each.length[c] // ticks), block, kept)


def _advance(m: Maps, c: Array, z: Moving) -> Moving:
    """Return what is moved, behind a chunk."""
    shared, fixed = matmul.same(m.shared_after[c], z.shared), matmul.same(m.common_after[c], z.shared)
    own = matmul.of_lanes(m.own_after[c], fixed, z.own) if m.own_after.shape[1] else jnp.zeros((0, 1))
    return Moving(own, shared)


def _find_divergence(
    p: GridPointParams, over: Callable[..., tuple[All, All]], blocks: Callable[..., PyTree], z: All, kept: All
) -> All:
    """Where a peak says that some lane has left its bound, go over the chunks again and note at which tick."""
    bad = {label: watch.first_bad for label, (_, watch) in kept.items()}
    stays = jnp.all(jnp.stack([block_metrics.stays(p, stream, watch) for stream, watch in kept.values()]))
    again = partial(over, partial(blocks, partial(block_metrics.first_bad, p)), z)
    found = lax.cond(stays, lambda bad: bad, lambda bad: again(bad)[1], bad)
    return {o: (stream, watch._replace(first_bad=found[o])) for o, (stream, watch) in kept.items()}


def _step_remaining(slow: Layout, stepped: Stepped, start: Array, stop: Array, state: State) -> State:
    """The state with those observers stepped that do not go by products; x is not yet moved."""
    if not slow.observers:
        return state

    def of(kept: dict[str, PyTree]) -> dict[str, PyTree]:
        return {label: kept[label] for label, _ in slow.observers if label in kept}

    mine = state._replace(memories=of(state.memories), streams=of(state.streams), watches=of(state.watches))
    after = stepped(slow, start, stop, mine)
    return state._replace(
        memories=state.memories | after.memories,
        streams=state.streams | after.streams,
        watches=state.watches | after.watches,
    )


def _step_counters(
    layout: Layout, p: GridPointParams, found: tuple[Form, ...], start: Array, stop: Array, state: State
) -> State:
    """The state with what observers count, which no error depends on, moved on tick by tick."""
    counting = [form for form in found if form.counted]
    if not counting:
        return state

    def counts(state: State) -> list[list[PyTree]]:
        return [[leaves_of(state, form.label)[i] for i in form.counted] for form in counting]

    def with_counts(numbers: list[list[PyTree]]) -> State:
        out = state
        for form, mine in zip(counting, numbers, strict=True):
            leaves = leaves_of(out, form.label)
            for i, a in zip(form.counted, mine, strict=True):
                leaves[i] = a
            out = with_leaves(out, form.label, leaves)
        return out

    def tick(k: Array, numbers: list[list[PyTree]]) -> list[list[PyTree]]:
        after = counts(steps.flow(layout, p, k, with_counts(numbers), jnp.zeros(0)))
        return lane_array.match_form(after, numbers, layout.width)

    return with_counts(lax.fori_loop(start, stop, tick, counts(state)))
