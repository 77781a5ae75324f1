"""Simulate many runs from event to event, keeping sums only.

The loop follows the hybrid system: at an event it *jumps* (samples are taken, packets arrive), then it *flows* tick by tick to
the next event. Ticks without an event need no checks. Time is common to all lanes. Events are common to all lanes, or each lane
has its own.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.engine import common_schedule, kernels, lane_array, random_schedules, steps
from pcbench.engine.initial_state import tick_sampler
from pcbench.simulation import innovation_stats
from pcbench.simulation.metrics import Weights
from pcbench.simulation.schedule.random_times import ClockParams
from pcbench.simulation.types import GridPointParams, Layout, Memories, RunSums, State


class EventFunctions(NamedTuple):
    """The functions that apply events, and the packing of memories between them."""

    apply: steps.ApplyEvents
    next_event: Callable[[Array, State], Array]  # (tick, state after its events) -> tick of the next event
    unpack: Callable[[PyTree], Memories] = lambda memories: memories  # packed -> the observers' memories
    # (after a flow, packed before it) -> packed
    repack: Callable[[Memories, PyTree], PyTree] = lambda memories, packed: memories


def simulate(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> RunSums:
    """Simulate one lane for each of seeds[L] over all windows, the last of one tick; L must be `layout.width`."""
    with kernels.separate_products(p.dt):
        return _simulate(layout, p, root_seed, seeds)


def _simulate(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> RunSums:
    layout = innovation_stats.add_innovation_stats(layout) if layout.consistency else layout
    events, state = _events(layout, p, root_seed, seeds)
    empty = {"streams": state.streams, "tracking": state.tracking, "effort": state.effort}
    end, sample = p.windows[-1, 0], tick_sampler(layout, p, root_seed, seeds)

    def tick(k: Array, state: State) -> State:
        full = state._replace(memories=events.unpack(state.memories))
        new = lane_array.match_form(steps.tick(layout, p, k, full, sample(k)), full, layout.width)
        return new._replace(memories=events.repack(new.memories, state.memories))

    def segment(edge: Array, k: Array, state: State) -> tuple[Array, State]:
        state = events.apply(k, state)  # a window edge without an event changes nothing
        next_event = events.next_event(k, state)
        stop = jnp.minimum(jnp.minimum(next_event, edge), end)  # the last tick has events but no flow
        state = lax.fori_loop(k, stop, tick, state)  # one tick per body: two would draw the noise twice
        return jnp.where(k < end, stop, k + 1), state

    def window(state: State, edges: Array) -> tuple[State, PyTree]:
        _, state = lax.while_loop(lambda c: c[0] < edges[1], lambda c: segment(edges[1], *c), (edges[0], state))
        return state._replace(**empty), (state.streams, state.tracking, state.effort)

    state, sums = lax.scan(window, state, p.windows)
    state = state._replace(memories=events.unpack(state.memories))
    last = steps.score(layout, p, end, state)  # the last tick only needs its error
    if isinstance(p.weights, Weights):  # and its command if the input is summed
        last = steps.control(layout, p, end, last, sample(end).command)
    errors = steps.errors(layout, p, end, state)
    squares = steps.squares(layout, p, end, state, errors) if layout.consistency else ()
    truth = steps.actual(layout, p, end, state)
    out = RunSums(
        streams=last.streams,
        watches=last.watches,
        final=errors,
        tracking=last.tracking,
        effort=last.effort,
        consistency=squares,
        actual=truth,
    )
    sums, out = jax.tree.map(lambda a: lane_array.to_array(a, layout.width), (sums, out), is_leaf=lane_array.is_lanes)
    last_sums = out.streams, out.tracking, out.effort
    streams, tracking, effort = jax.tree.map(lambda a, b: a.at[-1].set(b), sums, last_sums)
    return out._replace(streams=streams, tracking=tracking, effort=effort)


def _events(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> tuple[EventFunctions, State]:
    """Return the events of a block of runs, on a common schedule or random ones, and the state before tick 0."""
    if isinstance(p.schedule, ClockParams):
        events, state = random_schedules.prepare(layout, p, root_seed, seeds)
        packing = events.memory_packing
        return EventFunctions(events.apply, events.next_event, packing.unpack, packing.repack), state
    apply, state = common_schedule.prepare(layout, p, root_seed, seeds)
    schedule = p.schedule
    return EventFunctions(apply, lambda k, state: schedule.next_event[k]), state
