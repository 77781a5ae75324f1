"""The steps of a tick, in their order: sense, deliver, estimate, control, flow; and `tick`, which takes them.

Plant and observers are one-lane functions carried over the lanes by `lanes.entrywise`. At which ticks something is sensed or
delivered say `events_shared` and `events_per_lane`. In an open loop all observers watch one plant. A closed loop
simulates a single observer, which drives a plant of its own (`closed_loop`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from jax import Array

from pcbench.dynamics.integrate import rk4
from pcbench.protocols import Arrival, Memory, Now
from pcbench.simulation import metrics
from pcbench.simulation.closed_loop import control, off_target, pushed, unless_diverged
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.problem import (
    Layout,
    Memories,
    Notes,
    Packet,
    PerLane,
    Problem,
    State,
    params_of,
    present,
    truth,
)
from pcbench.simulation.sample_noise import rounded

Happen = Callable[[Array, State], State]  # (tick, state) -> state after all that is sensed and delivered at the tick
Read = Callable[[Array, State], Any]  # (tick, state) -> what is to be kept of it


class Drawn(NamedTuple):
    """What every run draws at a tick, whatever happens."""

    process: PerLane  # [n] noise of the state before scaling; [0]: none
    command: Any = ()  # network.Drawn, of a loop with a network


class Row(NamedTuple):
    """What is known of an arrival besides what it brings; q outputs."""

    fresh: PerLane  # [q]
    age: PerLane  # [q] as the observers believe it
    number: PerLane  # [q]
    since: PerLane


def nothing(k: Array, state: State) -> State:
    """Return the state unchanged: the `happen` of a tick without events."""
    return state


def tick(
    layout: Layout, p: Problem, k: Array, state: State, drawn: Drawn, happen: Happen = nothing, read: Read | None = None
) -> tuple[State, Any]:
    """Return the state at tick k + 1, and what `read` finds at tick k once its command is given.

    This is the order of events of `simulate_runs.tick`, on many lanes. `loop.simulate` lets events happen itself where there
    are any, and takes the ticks from there to the next without.
    """
    state = happen(k, state)  # 1. sense, 2. deliver
    state = score(layout, p, k, state)  # 3. estimate
    state = control(layout, p, k, state, drawn.command)  # 4. control
    seen = read(k, state) if read else None
    return flow(layout, p, k, state, drawn.process), seen  # 5. flow


# 1. sense


def measure(layout: Layout, p: Problem, k: Array, state: State, noise: PerLane) -> PerLane:
    """Return what every channel measures at tick k: y[q] with its noise [q], and rounded where it is (`sample_noise`).

    In a closed loop y does not see u.
    """
    q = p.noise_std.shape[0]

    def one_lane(k: Array, x: Array, drawn: Any, v: Array) -> Array:
        y = layout.plant.output(params_of(layout, p, drawn), present(p, k, True), x)
        if layout.continuous:
            return y
        y = y + p.noise_std * v[:q]
        return rounded(p.rounding, y, v[q:]) if p.rounding else y

    return over(one_lane)(k, state.x, state.drawn, noise)


def note(layout: Layout, p: Problem, k: Array, state: State) -> Notes:
    """Return what every observer notes at tick k."""

    def one_lane(k: Array, memories: Memories, commands: Any) -> Notes:
        now = present(p, k, False, commands)
        return {label: o.note(p.gains[label], memories[label], now) for label, o in layout.observers}

    return over(one_lane)(k, state.memories, state.commands)


def told(layout: Layout, p: Problem, k: Array, state: State, fresh: PerLane) -> Memories:
    """Return the memories after observers were told which channels [q] are sampled at tick k; `tells` says whether any is."""

    def one_lane(k: Array, memories: Memories, commands: Any, watches: Any, fresh: Array) -> Memories:
        now = present(p, k, False, commands)
        after = memories | {
            label: o.sampled(p.gains[label], memories[label], now, fresh) for label, o in layout.observers if o.sampled
        }
        return unless_diverged(watches, after, memories) if layout.controller else after

    watches = state.watches if layout.controller else {}
    return over(one_lane)(k, state.memories, state.commands, watches, fresh)


def tells(layout: Layout) -> bool:
    """Whether any observer is told at sampling time."""
    return any(o.sampled for _, o in layout.observers)


# 2. deliver


def jump(layout: Layout, p: Problem, k: Array, state: State, row: Row, packet: Packet) -> Memories:
    """Return the memories after a packet that arrives at tick k."""

    def one_lane(k: Array, memories: Memories, commands: Any, watches: Any, row: Row, packet: Packet) -> Memories:
        now = present(p, k, False, commands)
        jumped = {
            label: o.jump(p.gains[label], memories[label], now, arrival_of(row, packet, label))
            for label, o in layout.observers
        }
        return unless_diverged(watches, jumped, memories) if layout.controller else jumped

    watches = state.watches if layout.controller else {}
    return over(one_lane)(k, state.memories, state.commands, watches, row, packet)


def arrival_of(row: Row, packet: Packet, label: str) -> Arrival:
    """Return a packet as it arrives at the observer of a label."""
    return Arrival(packet.values, row.fresh, row.age, row.number, packet.notes[label], row.since)


# 3. estimate


def estimates(layout: Layout, p: Problem, state: State) -> dict[str, PerLane]:
    """Return what every observer estimates, as the state stands: [n] or [n + s]."""

    def one_lane(memories: Memories) -> dict[str, Array]:
        return {label: o.estimate(p.gains[label], memories[label]) for label, o in layout.observers}

    return over(one_lane)(state.memories)


def actual(layout: Layout, p: Problem, k: Array, state: State) -> PerLane:
    """Return what observers estimate, as it is at tick k: [n + s]."""

    def one_lane(k: Array, x: Array, drawn: Any) -> Array:
        return truth(layout, params_of(layout, p, drawn), present(p, k, True), x)

    return over(one_lane)(k, state.x, state.drawn)


def errors(layout: Layout, p: Problem, k: Array, state: State) -> dict[str, PerLane]:
    """Return e of every observer at tick k, of all that it estimates."""
    subtract = over(lambda z, found: {label: z[: each.shape[0]] - each for label, each in found.items()})
    return subtract(actual(layout, p, k, state), estimates(layout, p, state))


def score(layout: Layout, p: Problem, k: Array, state: State) -> State:
    """Take the error of every estimate at tick k into streams and watches, and in a closed loop what is off the set point."""

    def one_lane(k: Array, e: dict[str, Array], streams: Any, watches: Any, tracking: Any, x: Array) -> Any:
        if layout.controller and state.tracking:
            tracking = metrics.update(tracking, off_target(layout.controller, p, k, x))
        updated = {label: metrics.update(stream, e[label]) for label, stream in streams.items()}
        looked = {label: metrics.look(w, k, e[label], p.band, p.bound, p.jumps) for label, w in watches.items()}
        return updated, looked, tracking

    e = errors(layout, p, k, state)
    streams, watches, tracking = over(one_lane)(k, e, state.streams, state.watches, state.tracking, state.x)
    return state._replace(streams=streams, watches=watches, tracking=tracking)


# 5. flow (4., control, is in `closed_loop`)


def flow(layout: Layout, p: Problem, k: Array, state: State, w: PerLane) -> State:
    """Move plant and observers from tick k to tick k + 1, the plant with the process noise w [n]."""

    def one_lane(k: Array, x: Array, drawn: Any, memories: Memories, watches: Any, commands: Any, w: Array) -> Any:
        now, params = present(p, k, True, commands), params_of(layout, p, drawn)
        if layout.continuous:
            moved, flowed = _together(layout, p, params, now, x, memories, commands)
        else:
            moved = layout.plant.step(params, pushed(now, commands), x)
            flowed = {label: o.flow(p.gains[label], memories[label], now) for label, o in layout.observers}
        moved = moved + _scaled(p.process_std, w) if w.size else moved
        if layout.controller:
            return unless_diverged(watches, (moved, flowed), (x, memories))
        return moved, flowed

    watches = state.watches if layout.controller else {}
    x, memories = over(one_lane)(k, state.x, state.drawn, state.memories, watches, state.commands, w)
    return state._replace(x=x, memories=memories)


def _scaled(std: Any, w: Array) -> Array:
    """Process noise [n] of the standard deviations std [n], or of the root std [n, n] of its covariance."""
    return std @ w if std.ndim == 2 else std * w


def _together(
    layout: Layout, p: Problem, params: Any, now: Now, x: Array, memories: Memories, commands: Any
) -> tuple[Array, Memories]:
    """Move plant and observers by one tick as one field: at every stage the observers see y of that stage."""
    plant_field: Any = layout.plant.field

    def field(t: Array, z: tuple[Array, dict[str, Memory]]) -> tuple[Array, dict[str, Memory]]:
        there, (x, memories) = now._replace(t=t), z
        y = layout.plant.output(params, there, x)
        rates = {label: o.field(p.gains[label], memories[label], there, y) for label, o in layout.observers if o.field}
        return plant_field(params, pushed(there, commands), x), rates

    return rk4(field, now.t, (x, memories), now.dt)
