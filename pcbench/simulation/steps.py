"""The steps of a run: measure, note, hand over, estimate, command and flow, for thousands of lanes at once.

Plant and observers are one-lane functions carried over the lanes by `lanes.entrywise`. When which step is taken, say
`events_shared` and `events_per_lane`; `loop` puts them in a loop. The rollout owns the packets in flight and the input
history: one array for all lanes, or in a closed loop each lane's own commands, in a ring. Observers share a plant in an open
loop; in a closed loop there is one, with a plant of its own.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pcbench.dynamics.integrate import rk4
from pcbench.protocols import Arrival, Now
from pcbench.simulation import draws, lanes, metrics
from pcbench.simulation.closed_loop import before, decide, off_target, unless_diverged
from pcbench.simulation.lanes import table
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.problem import Layout, Problem, State, params_of, present, truth
from pcbench.simulation.schedule.per_lane import Times


class Row(NamedTuple):
    """What is known of an arrival besides what it brings; q outputs."""

    fresh: Any  # [q]
    age: Any  # [q] as the observers believe it
    number: Any  # [q]
    since: Any


def process_noise(p: Problem, root_seed: Array, seeds: Array) -> Callable[[Array], Any]:
    """Return what draws the process noise of tick k, a standard normal for each state; nothing where there is none."""
    keys = draws.run_keys(root_seed, seeds, "process", p.process_std.shape[0])
    return lambda k: lanes.split(draws.normals(keys, [k for _ in keys])) if keys else jnp.zeros(0)


def advance(layout: Layout, p: Problem, k: Any, state: State, drawn: Any) -> State:
    """Estimate and measure the error at tick k, then flow to tick k + 1, with the process noise that is `drawn`."""

    def one_lane(
        k: Array, x: Array, own: Any, memories: Any, streams: Any, watches: Any, w: Array, commands: Any, tracking: Any
    ) -> Any:
        now, params = present(p, k, True, commands), params_of(layout, p, own)
        actual = truth(layout, params, now, x)
        new: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
        for label, observer in layout.observers:
            estimated = observer.estimate(p.gains[label], memories[label])
            e = actual[: estimated.shape[0]] - estimated
            new[0][label] = metrics.update(streams[label], e)
            if layout.watch:
                new[1][label] = metrics.look(watches[label], k, e, p.band, p.bound, p.jumps)
        if layout.continuous:
            moved, flowed = together(layout, p, params, now, x, memories)
        else:
            moved = layout.plant.step(params, now, x)
            flowed = {label: o.flow(p.gains[label], memories[label], now) for label, o in layout.observers}
        moved = moved + p.process_std * w if w.size else moved
        if layout.controller:
            tracking = metrics.update(tracking, off_target(layout.controller, p, k, x))
            moved, flowed = unless_diverged(new[1], (moved, flowed), (x, memories))
        return moved, flowed, *new, tracking

    x, *rest = over(one_lane)(
        k, state.x, state.own, state.memories, state.streams, state.watches, drawn, state.commands, state.tracking
    )
    return state._replace(x=x, memories=rest[0], streams=rest[1], watches=rest[2], tracking=rest[3])


def together(layout: Layout, p: Problem, params: Any, now: Now, x: Array, memories: Any) -> tuple[Array, Any]:
    """Move plant and observers by one tick as one field: at every stage the observers see y of that stage."""
    plant_field: Any = layout.plant.field

    def field(t: Array, z: tuple[Array, Any]) -> tuple[Array, Any]:
        there, (x, memories) = now._replace(t=t), z
        y = layout.plant.output(params, there, x)
        rates = {label: o.field(p.gains[label], memories[label], there, y) for label, o in layout.observers if o.field}
        return plant_field(params, there, x), rates

    return rk4(field, now.t, (x, memories), now.dt)


def measure(layout: Layout, p: Problem, k: Any, x: Any, own: Any, noise: Any) -> Any:
    """Return what every channel measures at tick k: y[q] with its noise; in a closed loop y does not see u."""

    def one_lane(k: Array, x: Array, own: Any, v: Array) -> Array:
        y = layout.plant.output(params_of(layout, p, own), present(p, k, True), x)
        return y if layout.continuous else y + p.noise_std * v

    return over(one_lane)(k, x, own, noise)


def note(layout: Layout, p: Problem, k: Any, memories: Any, commands: Any = ()) -> dict[str, Any]:
    """Return what every observer notes at tick k."""

    def one_lane(k: Array, memories: Any, commands: Any) -> Any:
        now = present(p, k, False, commands)
        return {label: o.note(p.gains[label], memories[label], now) for label, o in layout.observers}

    return over(one_lane)(k, memories, commands)


def hand_over(
    layout: Layout, p: Problem, k: Any, row: Row, packet: Any, memories: Any, commands: Any = (), watches: Any = ()
) -> dict[str, Any]:
    """Let every observer jump with a packet that arrives at tick k; return their memories."""

    def one_lane(k: Array, row: Row, packet: Any, memories: Any, commands: Any, watches: Any) -> Any:
        value, notes = packet
        now = present(p, k, False, commands)
        jumped = {
            label: o.jump(p.gains[label], memories[label], now, Arrival(value, *row[:3], notes[label], row.since))
            for label, o in layout.observers
        }
        return unless_diverged(watches, jumped, memories) if layout.controller else jumped

    return over(one_lane)(k, row, packet, memories, commands, watches)


def begin(layout: Layout, p: Problem, root_seed: Array, seeds: Array) -> State:
    """Return the state before tick 0, with whatever will differ between lanes already spread over them.

    `flight` is one packet, what the start would put on the network: events make rings of it.
    """
    n, q = p.x0.shape[0], p.noise_std.shape[0]
    x: Any = p.x0
    if layout.random_start:
        normal = draws.normals(draws.run_keys(root_seed, seeds, "initial", n), jnp.zeros(n, int))
        x = over(lambda v: p.x0 + p.spread0 @ v)(lanes.split(normal))
    own: Any = ()
    if layout.drifting:
        own = lanes.split(draws.uniforms(root_seed, seeds, "drift", jnp.asarray(0), 1, layout.plant.drawn)[0])
    xhat0: Any = p.xhat0
    if layout.scattered:
        uniform = lanes.split(draws.uniforms(root_seed, seeds, "initial", jnp.asarray(0), 1, n)[0])
        xhat0 = over(lambda v: p.xhat0 + p.scatter * (2 * v - 1))(uniform)
    memories = over(lambda xhat0: {label: o.init(p.gains[label], xhat0) for label, o in layout.observers})(xhat0)
    k = jnp.asarray(0)
    commands, tracking = before(layout, p, memories)
    packet = jnp.zeros(q), note(layout, p, k, memories, commands)
    size = {label: found.shape[0] for label, found in _estimates(layout, p, memories).items()}
    streams = {label: metrics.start(many) for label, many in size.items()}
    watches = {label: metrics.start_watch(many) for label, many in size.items()} if layout.watch else {}
    state = State(x, own, memories, packet, streams, watches, commands, tracking)
    noise = lanes.split(jnp.zeros((q, layout.width)))
    random, drawn = isinstance(p.schedule, Times), process_noise(p, root_seed, seeds)(k)
    row: Any = Row(jnp.ones(q, bool), jnp.zeros(q, int), jnp.zeros(q, int), k)
    row = jax.tree.map(lambda a: lanes.spread(a, layout.width), row) if random else row

    def everything(state: State) -> State:  # one tick on which all happens: what it makes different is per lane
        packet = measure(layout, p, k, state.x, state.own, noise), note(layout, p, k, state.memories, state.commands)
        memories = hand_over(layout, p, k, row, packet, state.memories, state.commands, state.watches)
        if random:  # what a jump changes at all, it changes in some lanes only
            memories = lanes.unless_same(memories, state.memories, layout.width)
        decided = decide(layout, p, k, state._replace(memories=memories))
        return advance(layout, p, k, decided, drawn)._replace(flight=packet)

    ready = jax.tree.map(lambda x: x if lanes.is_lanes(x) else jnp.asarray(x), state, is_leaf=lanes.is_lanes)
    return lanes.settle(everything, ready._replace(commands=table(ready.commands)), layout.width)


def actual(layout: Layout, p: Problem, k: Array, state: State) -> Any:
    """Return what observers estimate, as it is at tick k: [n + s]."""

    def one_lane(k: Array, x: Array, own: Any) -> Array:
        return truth(layout, params_of(layout, p, own), present(p, k, True), x)

    return over(one_lane)(k, state.x, state.own)


def estimates(layout: Layout, p: Problem, state: State) -> dict[str, Any]:
    """Return what every observer estimates, as the state stands: [n] or [n + s]."""
    return _estimates(layout, p, state.memories)


def _estimates(layout: Layout, p: Problem, memories: Any) -> dict[str, Any]:
    def one_lane(memories: Any) -> Any:
        return {label: o.estimate(p.gains[label], memories[label]) for label, o in layout.observers}

    return over(one_lane)(memories)


def errors(layout: Layout, p: Problem, k: Array, state: State) -> dict[str, Any]:
    """Return e of every observer at tick k, of all that it estimates."""
    subtract = over(lambda z, found: {label: z[: each.shape[0]] - each for label, each in found.items()})
    return subtract(actual(layout, p, k, state), estimates(layout, p, state))


class Last(NamedTuple):
    """What the last tick leaves: its own window's streams, the error itself, the watches."""

    streams: Any
    tracking: Any
    error: Any
    watches: Any


def final(layout: Layout, p: Problem, k: Array, state: State) -> Last:
    """Measure the error at the last tick k, after its events."""
    e = errors(layout, p, k, state)

    def one_lane(e: Any, watches: Any, x: Array) -> Any:
        streams = {label: metrics.update(metrics.start(e[label].shape[0]), e[label]) for label in e}
        looked = {label: metrics.look(w, k, e[label], p.band, p.bound, p.jumps) for label, w in watches.items()}
        tracking: Any = ()
        if layout.controller:
            off = off_target(layout.controller, p, k, x)
            tracking = metrics.update(metrics.start(off.shape[0]), off)
        return streams, tracking, looked

    streams, tracking, watches = over(one_lane)(e, state.watches, state.x)
    return Last(streams, tracking, e, watches)
