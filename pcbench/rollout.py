"""The steps of a run: measure, note, hand over, estimate, command and flow, for thousands of lanes at once.

Plant and observers are one-lane functions carried over the lanes by `pcbench.entrywise`. When which step is taken, say
`shared_events` and `own_events`; `simulation` puts them in a loop. The rollout owns the packets in flight and the input
history: one array for all lanes, or in a closed loop each lane's own commands, in a ring. Observers share a plant in an open
loop; in a closed loop there is one, with a plant of its own.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench import actuator, draws, lanes, metrics
from pcbench.entrywise import over
from pcbench.integrate import rk4
from pcbench.irregular import Times
from pcbench.lanes import table
from pcbench.types import Arrival, Controller, Gains, Leaf, Now, Observer, Plant


class Layout(NamedTuple):
    """What fixes the compiled program; everything else is traced."""

    plant: Plant
    observers: tuple[tuple[str, Observer], ...]  # (label, functions)
    width: int  # lanes
    ring: int  # packets the network can hold
    random_start: bool  # x(0) = x0 + spread0 @ normal instead of x0
    watch: bool = True  # settling time and divergence, besides the streams
    strides: bool = True  # flow goes by two ticks where it can; of no use where there is an event at nearly every tick
    continuous: bool = False  # plant and observers are one field, and y is measured at each of its stages
    drifting: bool = False  # the plant's numbers are of each run's own
    controller: Controller | None = None  # of a closed loop, which has one observer
    commands: int = 0  # rows of the closed loop's ring of commands
    scattered: bool = False  # xhat(0) = xhat0 + scatter (2 uniform - 1) instead of xhat0


class Problem(NamedTuple):
    """The numbers of one cell: everything traced. N ticks, n states, s unknowns beside them, m inputs, q outputs."""

    params: Any  # the plant's
    gains: dict[str, Gains]  # by observer label
    schedule: Any  # a Schedule, the same for every run; or Times: then each run draws its own
    inputs: Leaf  # [N+1, m] u held over [t_k, t_k+1)
    dt: Leaf  # [s]
    x0: Leaf  # [n] the start, or its mean
    xhat0: Leaf  # [n]
    spread0: Leaf  # [n, n] a square root of the start's covariance, where it is random
    noise_std: Leaf  # [q]
    band: Leaf  # [n + s] settling band of |e|
    bound: Leaf  # [n + s] beyond it a run has diverged
    windows: Leaf  # [W, 2] first tick and end of each window; the last is one tick, N-1
    process_std: Leaf = np.zeros(0)  # [n] of the noise added to each state at every tick; [0]: none
    jumps: Leaf = np.zeros(0, int)  # [J] ticks of the tail at which the unknown input jumps
    control: Any = ()  # the controller's numbers
    line: actuator.Line = actuator.NONE
    scatter: Leaf = np.zeros(0)  # [n] of xhat(0), where it is random


class State(NamedTuple):
    """What a block of lanes carries from tick to tick."""

    x: Any
    own: Any  # numbers the run has drawn for its plant; (): none
    memories: Any  # by observer label
    flight: Any  # packets on the network: measured values and notes
    streams: dict[str, metrics.Stream]
    watches: dict[str, metrics.Watch]
    commands: Any = ()  # [R, m] of a closed loop
    tracking: Any = ()  # metrics.Stream of the set point less the state, in a closed loop


class Outcome(NamedTuple):
    """What a block of lanes leaves, by observer label; every array ends in lanes [L]. n: what the observer estimates."""

    streams: dict[str, metrics.Stream]  # [W, n, L]
    watches: dict[str, metrics.Watch]  # [n, L]
    final: dict[str, Array]  # [n, L] the error at tick N-1
    tracking: Any = ()  # Stream [W, r, L] of a closed loop


def present(p: Problem, k: Array, decided: bool, commands: Any = ()) -> Now:
    """The present at tick k; u_k is known (`decided`) to the plant and to flow, not to note and jump.

    In a closed loop the inputs are those that the `commands` [R, m] become.
    """

    def past_u(age: Array) -> Array:
        if isinstance(commands, tuple):
            return jnp.where(k >= age, p.inputs[jnp.maximum(k - age, 0)], 0.0)
        return actuator.read(p.line, commands, k - age, k if decided else k - 1)

    return Now(k * p.dt, k, p.dt, past_u(jnp.asarray(0 if decided else 1)), past_u)


def params_of(layout: Layout, p: Problem, own: Any) -> Any:
    """Return the plant's numbers in the run that has drawn `own`."""
    return layout.plant.of_run(p.params, own) if layout.drifting and layout.plant.of_run else p.params


def truth(layout: Layout, params: Any, now: Now, x: Array) -> Array:
    """Return what observers estimate, as it is: the state, and what the plant has of unknowns, [n + s]."""
    return jnp.append(x, layout.plant.unknown(params, now, x)) if layout.plant.unknown else x


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


def decide(layout: Layout, p: Problem, k: Any, state: State) -> State:
    """Let the controller of a closed loop give its command of tick k, made of the estimate of now."""
    if layout.controller is None:
        return state
    ((label, observer),), controller = layout.observers, layout.controller

    def one_lane(k: Array, memory: Any, commands: Array) -> Array:
        def coming(i: Array) -> Array:
            return actuator.read(p.line, commands, k + i, k - 1)

        now, xhat = present(p, k, False, commands), observer.estimate(p.gains[label], memory)
        return actuator.write(commands, k, controller.command(p.control, now, xhat, coming))

    return state._replace(commands=over(one_lane)(k, state.memories[label], state.commands))


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


def off_target(controller: Controller, p: Problem, k: Array, x: Array) -> Array:
    """Return the set point less the state, of the states that are to follow it: [r]."""
    target = controller.target(p.control, k)
    return target - x[: target.shape[0]]


def unless_diverged(watches: dict[str, metrics.Watch], new: Any, old: Any) -> Any:
    """Keep a diverged run of a closed loop as it was when it diverged: its lane is frozen.

    Ticks and sample numbers go on: they are the same in all lanes, and loops over them are to stay shared.
    """
    bad = jnp.any(jnp.stack([watch.first_bad >= 0 for watch in watches.values()])) if watches else jnp.asarray(False)

    def one(a: Array, b: Array) -> Array:
        number = jnp.issubdtype(jnp.result_type(b), jnp.floating)
        return jnp.where(bad, b, a) if number else a.astype(jnp.result_type(b))

    return jax.tree.map(one, new, old)


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


def before(layout: Layout, p: Problem, memories: Any) -> tuple[Any, Any]:
    """Return a closed loop's commands of the time before 0, and the stream of what it is off its target."""
    if layout.controller is None:
        return (), ()
    ((label, observer),), controller = layout.observers, layout.controller

    def one_lane(memory: Any) -> Array:
        xhat = observer.estimate(p.gains[label], memory)
        ticks = jnp.arange(-layout.commands, 0)  # tick n stands in row n mod R
        return lax.map(lambda n: controller.before(p.control, n, xhat), ticks)  # a loop: a row at a time, not R copies

    commands = over(one_lane)(memories[label])
    return commands, metrics.start(off_target(controller, p, jnp.asarray(0), p.x0).shape[0])


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


def held(layout: Layout, p: Problem, k: Array, state: State) -> Any:
    """Return the input held over tick k, once it is decided: [m]."""
    return over(lambda k, commands: present(p, k, True, commands).u)(k, state.commands)


def aims(layout: Layout, p: Problem, k: Array) -> Array:
    """Return the set point of tick k, [r]; of an open loop [0]."""
    return layout.controller.target(p.control, k) if layout.controller else jnp.zeros(0)


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
