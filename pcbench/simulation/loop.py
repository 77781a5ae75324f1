"""One run, tick by tick: sense, deliver, estimate, control, flow; thousands of lanes at once.

The loop is shaped like the hybrid system it simulates: at an event it *jumps* (samples are taken, packets arrive), then
it *flows* tick after tick to the next event, so nothing is asked at a tick where nothing happens. Time is the same in
all lanes; the events are shared by all, or each lane has its own.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import events_per_lane, events_shared, lanes
from pcbench.simulation.closed_loop import decide
from pcbench.simulation.problem import Layout, Outcome, Problem, State
from pcbench.simulation.schedule.per_lane import Times
from pcbench.simulation.steps import advance, final, process_noise


def simulate(layout: Layout, p: Problem, root_seed: Array, seeds: Array) -> Outcome:
    """Simulate one lane for each of seeds[L] over all windows, the last of one tick; L must be `layout.width`."""
    kind = events_per_lane if isinstance(p.schedule, Times) else events_shared
    events, state = kind.prepare(layout, p, root_seed, seeds)
    empty, end = {"streams": state.streams, "tracking": state.tracking}, p.windows[-1, 0]
    drawn = process_noise(p, root_seed, seeds)

    def tick(k: Array, state: State) -> State:
        full = state._replace(memories=events.whole(state.memories))
        new = lanes.like(advance(layout, p, k, decide(layout, p, k, full), drawn(k)), full, layout.width)
        return new._replace(memories=events.moved(new.memories, state.memories))

    def flow(start: Array, stop: Array, state: State) -> State:
        def pair(i: Array, state: State) -> State:  # two ticks in one body: 1.3 times as fast as one (memory passes)
            return tick(start + 2 * i + 1, tick(start + 2 * i, state))

        if not layout.strides:
            return lax.fori_loop(start, stop, tick, state)
        pairs = (stop - start) // 2
        state = lax.fori_loop(0, pairs, pair, state)
        return lax.fori_loop(start + 2 * pairs, stop, tick, state)

    def segment(edge: Array, k: Array, state: State) -> tuple[Array, State]:
        state, following = events.happen(k, state)  # a window's edge may be no event: then nothing happens
        stop = jnp.minimum(jnp.minimum(following, edge), end)  # the last tick's events happen, its flow is not needed
        return jnp.where(k < end, stop, k + 1), flow(k, stop, state)

    def window(state: State, edges: Array) -> tuple[State, Any]:
        _, state = lax.while_loop(lambda c: c[0] < edges[1], lambda c: segment(edges[1], *c), (edges[0], state))
        return state._replace(**empty), (state.streams, state.tracking)

    state, sums = lax.scan(window, state, p.windows)
    last = final(layout, p, end, state._replace(memories=events.whole(state.memories)))
    sums, last = jax.tree.map(lambda a: lanes.whole(a, layout.width), (sums, last), is_leaf=lanes.is_lanes)
    streams, tracking = jax.tree.map(lambda a, b: a.at[-1].set(b), sums, (last.streams, last.tracking))
    return Outcome(streams, last.watches, last.error, tracking)
