"""One run, tick by tick: sense, deliver, estimate, flow; thousands of lanes at once.

The loop is shaped like the hybrid system it simulates: at an event it *jumps* (samples are taken, packets arrive), then
it *flows* tick after tick to the next event, so nothing is asked at a tick where nothing happens. Whole-number data
(`sampling.Schedule`) say where the events are; they are traced, so one compiled program serves every period and delay.
Plant and observers are one-lane functions carried over the lanes by `pcbench.lanes`.

The rollout owns the packets in flight (a ring by packet number) and the input history (one array for all lanes).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench import draws, lanes, metrics
from pcbench.irregular import Times
from pcbench.types import Arrival, Gains, Leaf, Now, Observer, Plant


class Layout(NamedTuple):
    """What fixes the compiled program; everything else is traced."""

    plant: Plant
    observers: tuple[tuple[str, Observer], ...]  # (label, functions)
    width: int  # lanes
    ring: int  # packets the network can hold
    random_start: bool  # x(0) ~ N(xhat0, P0) instead of x0
    watch: bool = True  # settling time and divergence, besides the streams


class Problem(NamedTuple):
    """The numbers of one cell: everything traced. N ticks, n states, m inputs, q outputs."""

    params: Any  # the plant's
    gains: dict[str, Gains]  # by observer label
    schedule: Any  # a Schedule, the same for every run; or random Times: then each run has its own (`apart`)
    inputs: Leaf  # [N+1, m] u held over [t_k, t_k+1)
    dt: Leaf  # [s]
    x0: Leaf  # [n]
    xhat0: Leaf  # [n]
    spread0: Leaf  # [n, n] a square root of P0: x0 = xhat0 + spread0 @ normal, where the start is random
    noise_std: Leaf  # [q]
    band: Leaf  # [n] settling band of |e|
    bound: Leaf  # [] beyond it a run has diverged
    windows: Leaf  # [W, 2] first tick and end of each window; the last is one tick, N-1


class State(NamedTuple):
    """What a block of lanes carries from tick to tick."""

    x: Any
    memories: dict[str, Any]
    flight: Any  # rings of measured values and of notes
    streams: dict[str, metrics.Stream]
    watches: dict[str, metrics.Watch]


class Outcome(NamedTuple):
    """What a block of lanes leaves, by observer label; every array ends in lanes [L]."""

    streams: dict[str, metrics.Stream]  # [W, n, L]
    watches: dict[str, metrics.Watch]  # [n, L]
    final: dict[str, Array]  # [n, L] the error at tick N-1


def present(p: Problem, k: Array, decided: bool) -> Now:
    """The present at tick k; u_k is known (`decided`) to the plant and to flow, not to note and jump."""

    def past_u(age: Array) -> Array:
        return jnp.where(k >= age, p.inputs[jnp.maximum(k - age, 0)], 0.0)

    return Now(k * p.dt, k, p.dt, past_u(jnp.asarray(0 if decided else 1)), past_u)


class Row(NamedTuple):
    """What is known of an arrival besides what it brings; q outputs."""

    fresh: Any  # [q]
    age: Any  # [q] as the observers believe it
    number: Any  # [q]
    since: Any


def advance(layout: Layout, p: Problem, k: Any, state: State) -> State:
    """Estimate and measure the error at tick k, then flow to tick k + 1."""

    def one_lane(k: Array, x: Array, memories: Any, streams: Any, watches: Any) -> Any:
        now = present(p, k, True)
        new: tuple[dict[str, Any], dict[str, Any], dict[str, Any]] = ({}, {}, {})
        for label, observer in layout.observers:
            gains, memory = p.gains[label], memories[label]
            e = x - observer.estimate(gains, memory)
            new[0][label] = observer.flow(gains, memory, now)
            new[1][label] = metrics.update(streams[label], e)
            if layout.watch:
                new[2][label] = metrics.look(watches[label], k, e, p.band, p.bound)
        return layout.plant.step(p.params, now, x), *new

    x, *rest = lanes.over(one_lane)(k, state.x, state.memories, state.streams, state.watches)
    return State(x, rest[0], state.flight, rest[1], rest[2])


def measure(layout: Layout, p: Problem, k: Any, x: Any, noise: Any) -> Any:
    """Return what every channel measures at tick k: y[q] with its noise."""

    def one_lane(k: Array, x: Array, v: Array) -> Array:
        return layout.plant.output(p.params, present(p, k, True), x) + p.noise_std * v

    return lanes.over(one_lane)(k, x, noise)


def note(layout: Layout, p: Problem, k: Any, memories: Any) -> dict[str, Any]:
    """Return what every observer notes at tick k."""

    def one_lane(k: Array, memories: Any) -> Any:
        now = present(p, k, False)
        return {label: o.note(p.gains[label], memories[label], now) for label, o in layout.observers}

    return lanes.over(one_lane)(k, memories)


def hand_over(layout: Layout, p: Problem, k: Any, row: Row, packet: Any, memories: Any) -> dict[str, Any]:
    """Let every observer jump with a packet that arrives at tick k; return their memories."""

    def one_lane(k: Array, row: Row, packet: Any, memories: Any) -> Any:
        value, notes = packet
        now = present(p, k, False)
        return {
            label: o.jump(p.gains[label], memories[label], now, Arrival(value, *row[:3], notes[label], row.since))
            for label, o in layout.observers
        }

    return lanes.over(one_lane)(k, row, packet, memories)


def happen(layout: Layout, p: Problem, keys: list[Array], k: Array, state: State) -> State:
    """Let everything that the schedule has for tick k happen: sense and note, then deliver, the oldest packet first.

    Only one packet, never the ring of them, goes through a `cond`, which would copy it: what is not there is written to
    the ring's last place, which nothing reads.
    """
    plan = p.schedule

    def put(rings: Any, number: Array, make: Any) -> Any:
        last = jax.tree.map(lambda ring: ring[layout.ring], rings)
        new = lax.cond(number >= 0, lambda: lanes.like(make(), last, layout.width), lambda: last)
        place = jnp.where(number >= 0, number % layout.ring, layout.ring)
        return jax.tree.map(lambda ring, v: lax.dynamic_update_index_in_dim(ring, v, place, 0), rings, new)

    def sense() -> Any:
        return measure(layout, p, k, state.x, lanes.split(draws.normals(keys, plan.sample[k])))

    values = put(state.flight[0], plan.sense[k], sense)
    notes = put(state.flight[1], plan.note[k], lambda: note(layout, p, k, state.memories))
    flight = (values, notes)

    def deliver(slot: int, memories: Any) -> Any:
        number = plan.arrive[k, slot]
        packet = jax.tree.map(partial(lax.dynamic_index_in_dim, index=number % layout.ring, keepdims=False), flight)
        fresh, age = plan.fresh[k, slot], jnp.full(plan.fresh[k, slot].shape, k - plan.believed[k, slot])
        row = Row(fresh, age, plan.number[k, slot], plan.since[k, slot])

        def jump(memories: Any) -> Any:
            return lanes.like(hand_over(layout, p, k, row, packet, memories), memories, layout.width)

        return lax.cond(number >= 0, jump, lambda memories: memories, memories)

    memories = state.memories
    for slot in range(plan.arrive.shape[1]):
        memories = deliver(slot, memories)
    return state._replace(memories=memories, flight=flight)


def begin(layout: Layout, p: Problem, root_seed: Array, seeds: Array) -> State:
    """Return the state before tick 0, with whatever will differ between lanes already spread over them.

    A packet that nothing was noted for (it is believed to be from before tick 0) carries the note of the start.
    """
    n, q = p.x0.shape[0], p.noise_std.shape[0]
    x: Any = p.x0
    if layout.random_start:
        normal = draws.normals(draws.run_keys(root_seed, seeds, "initial", n), jnp.zeros(n, int))
        x = lanes.over(lambda v: p.xhat0 + p.spread0 @ v)(lanes.split(normal))
    labels = [label for label, _ in layout.observers]
    memories = {label: observer.init(p.gains[label], p.xhat0) for label, observer in layout.observers}
    k = jnp.asarray(0)
    state = State(
        x,
        memories,
        (jnp.zeros(q), note(layout, p, k, memories)),
        {label: metrics.start(n) for label in labels},
        {label: metrics.start_watch(n) for label in labels} if layout.watch else {},
    )
    state = jax.tree.map(jnp.asarray, state)
    if isinstance(p.schedule, Times):  # every lane is at a tick of its own, so all that has a size differs
        return lanes.everywhere(state, layout.width)
    noise = lanes.split(jnp.zeros((q, layout.width)))

    def everything(state: State) -> State:  # one tick on which all happens: what it makes different is per lane
        packet = measure(layout, p, k, state.x, noise), note(layout, p, k, state.memories)
        row = Row(jnp.ones(q, bool), jnp.zeros(q, int), jnp.zeros(q, int), k)
        memories = hand_over(layout, p, k, row, packet, state.memories)
        return advance(layout, p, k, state._replace(memories=memories))._replace(flight=packet)

    state = lanes.settle(everything, state, layout.width)
    return state._replace(flight=_rings(layout, state.flight))


def _rings(layout: Layout, packet: Any) -> Any:
    return jax.tree.map(lambda v: jnp.broadcast_to(v, (layout.ring + 1, *jnp.shape(v))), packet)


def estimates(layout: Layout, p: Problem, state: State) -> dict[str, Any]:
    """Return xhat of every observer, as the state stands."""

    def one_lane(memories: Any) -> Any:
        return {label: o.estimate(p.gains[label], memories[label]) for label, o in layout.observers}

    return lanes.over(one_lane)(state.memories)


def errors(layout: Layout, p: Problem, state: State) -> dict[str, Any]:
    """Return e = x - xhat of every observer, as the state stands."""
    subtract = lanes.over(lambda x, estimates: {label: x - xhat for label, xhat in estimates.items()})
    return subtract(state.x, estimates(layout, p, state))


def simulate(layout: Layout, p: Problem, root_seed: Array, seeds: Array) -> Outcome:
    """Simulate one lane for each of seeds[L] on one schedule over all windows; L must be `layout.width`."""
    plan = p.schedule
    keys = draws.run_keys(root_seed, seeds, "measurement", p.noise_std.shape[0])
    state = begin(layout, p, root_seed, seeds)
    empty = state.streams

    def flow(start: Array, stop: Array, state: State) -> State:
        def tick(k: Array, state: State) -> State:
            return lanes.like(advance(layout, p, k, state), state, layout.width)

        def pair(i: Array, state: State) -> State:  # two ticks in one body: 1.3 times as fast as one (memory passes)
            return tick(start + 2 * i + 1, tick(start + 2 * i, state))

        pairs = (stop - start) // 2
        state = lax.fori_loop(0, pairs, pair, state)
        return lax.fori_loop(start + 2 * pairs, stop, tick, state)

    def window(state: State, edges: Array) -> tuple[State, Any]:
        def segment(carry: Any) -> Any:
            k, state, _ = carry
            state = happen(layout, p, keys, k, state)  # a window's edge may be no event: then nothing happens
            stop = jnp.minimum(plan.next_event[k], edges[1])
            return stop, flow(k, stop, state), lanes.like(errors(layout, p, state), final, layout.width)

        final = errors(layout, p, state)
        _, state, last = lax.while_loop(lambda c: c[0] < edges[1], segment, (edges[0], state, final))
        return state._replace(streams=empty), (state.streams, last)

    state, (streams, last) = lax.scan(window, state, p.windows)
    whole = jax.tree.map(lambda a: lanes.whole(a, layout.width), (streams, state.watches, last), is_leaf=lanes.is_lanes)
    return Outcome(whole[0], whole[1], jax.tree.map(lambda e: e[-1], whole[2]))
