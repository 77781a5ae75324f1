"""The steps of a tick on many lanes: the functions of one run in `simulate_runs`, applied to all lanes.

`common_schedule` and `random_schedules` decide at which ticks samples are taken and delivered. In an open loop all observers
share one plant. A closed loop has one observer and its own plant.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from jax import Array
from jaxtyping import PyTree

from pcbench.engine.interpreter import vmap_entrywise
from pcbench.protocols import Arrival
from pcbench.simulation import metrics, simulate_runs
from pcbench.simulation.closed_loop import tracking_error
from pcbench.simulation.simulate_runs import Run, freeze_diverged
from pcbench.simulation.types import (
    ArrivalInfo,
    GridPointParams,
    Layout,
    Memories,
    Packet,
    PerLane,
    Snapshots,
    State,
    params_of,
    present,
    truth,
)

ApplyEvents = Callable[[Array, State], State]  # (tick, state) -> state after all samples and deliveries of the tick


class TickNoise(NamedTuple):
    """The random numbers of every run at a tick."""

    process: PerLane  # [n] process noise before scaling; [0]: none
    command: PyTree = ()  # command_network.CommandDraws, for a loop with a network


class Lane(NamedTuple):
    """The part of a state that steps read; for one lane, a part of a `Run`."""

    x: PyTree = ()
    memories: PyTree = ()
    commands: PyTree = ()
    watches: PyTree = ()  # of a closed loop, which is frozen once it has diverged

    @property
    def run(self) -> Run:
        """Return it as a `Run` of the definition."""
        return Run(self.x, self.memories, Packet((), {}), {}, self.watches, self.commands)


def observer_view(layout: Layout, state: State) -> Lane:
    """Return the observers' view of a state."""
    return Lane((), state.memories, state.commands, state.watches if layout.controller else {})


def tick(layout: Layout, p: GridPointParams, k: Array, state: State, noise: TickNoise) -> State:
    """Return the state at tick k + 1 from one at tick k after its events, in the order of `simulate_runs.tick`."""
    state = score(layout, p, k, state)  # 3. estimate
    state = control(layout, p, k, state, noise.command)  # 4. control
    return flow(layout, p, k, state, noise.process)  # 5. flow


# 1. sense


def measure(layout: Layout, p: GridPointParams, k: Array, state: State, noise: PerLane) -> PerLane:
    """Return the measurement of every channel at tick k, [q]."""

    def one_lane(k: Array, x: Array, plant_draws: PyTree, v: Array) -> Array:
        return simulate_runs.measure(layout, p, params_of(layout, p, plant_draws), k, x, v)

    return vmap_entrywise(one_lane)(k, state.x, state.plant_draws, noise)


def snapshot(layout: Layout, p: GridPointParams, k: Array, state: State) -> Snapshots:
    """Return the snapshot of every observer at tick k."""
    return vmap_entrywise(partial(simulate_runs.take_snapshots, layout, p))(k, state.memories, state.commands)


def notify_sampled(layout: Layout, p: GridPointParams, k: Array, state: State, mask: PerLane) -> Memories:
    """Return the memories after observers with `on_sample` are notified which channels [q] are sampled at tick k."""

    def one_lane(k: Array, lane: Lane, mask: Array) -> Memories:
        memories = simulate_runs.notify(layout, p, k, lane.run, mask)
        return freeze_diverged(layout, lane.run, memories, lane.memories)

    return vmap_entrywise(one_lane)(k, observer_view(layout, state), mask)


def any_is_notified(layout: Layout) -> bool:
    """Return whether any observer has `on_sample`."""
    return any(o.on_sample for _, o in layout.observers)


# 2. deliver


def jump(layout: Layout, p: GridPointParams, k: Array, state: State, info: ArrivalInfo, packet: Packet) -> Memories:
    """Return the memories after a packet that arrives at tick k."""

    def one_lane(k: Array, lane: Lane, info: ArrivalInfo, packet: Packet) -> Memories:
        arrival = partial(
            Arrival, packet.values, info.mask, info.age, info.number, ticks_since_arrival=info.ticks_since_arrival
        )
        memories = simulate_runs.jump(layout, p, k, lane.run, packet.snapshots, arrival)
        return freeze_diverged(layout, lane.run, memories, lane.memories)

    return vmap_entrywise(one_lane)(k, observer_view(layout, state), info, packet)


# 3. estimate


def estimates(layout: Layout, p: GridPointParams, state: State) -> dict[str, PerLane]:
    """Return the estimate of every observer in this state: [n] or [n + s]."""

    def one_lane(memories: Memories) -> dict[str, Array]:
        return {label: o.estimate(p.gains[label], memories[label]) for label, o in layout.observers}

    return vmap_entrywise(one_lane)(state.memories)


def actual(layout: Layout, p: GridPointParams, k: Array, state: State) -> PerLane:
    """Return the true values of the estimated signals at tick k: [n + s]."""

    def one_lane(k: Array, x: Array, plant_draws: PyTree) -> Array:
        return truth(layout, params_of(layout, p, plant_draws), present(p, k, True), x)

    return vmap_entrywise(one_lane)(k, state.x, state.plant_draws)


def errors(layout: Layout, p: GridPointParams, k: Array, state: State) -> dict[str, PerLane]:
    """Return e of every observer at tick k for all that it estimates."""

    def one_lane(k: Array, lane: Lane, plant_draws: PyTree) -> dict[str, Array]:
        return simulate_runs.errors(layout, p, params_of(layout, p, plant_draws), k, lane.run)

    return vmap_entrywise(one_lane)(k, Lane(state.x, state.memories, state.commands), state.plant_draws)


def score(layout: Layout, p: GridPointParams, k: Array, state: State) -> State:
    """Add the errors of tick k to the sums and settling states, and in a closed loop the tracking error."""

    def intervals_of_lane(k: Array, lane: Lane, plant_draws: PyTree) -> dict[str, PyTree]:
        return simulate_runs.intervals(layout, p, params_of(layout, p, plant_draws), k, lane.run)

    def one_lane(
        k: Array, e: PyTree, intervals: PyTree, streams: PyTree, watches: PyTree, tracking: PyTree, x: Array
    ) -> PyTree:
        if layout.controller and state.tracking:
            tracking = metrics.add_error(tracking, tracking_error(layout.controller, p, k, x))
        new_streams = {label: metrics.add_error(stream, e[label]) for label, stream in streams.items()}
        new_watches = {
            label: metrics.update_settling(w, k, e[label], p.band, p.bound, p.jumps, intervals.get(label, ()))
            for label, w in watches.items()
        }
        return new_streams, new_watches, tracking

    e, lane = errors(layout, p, k, state), Lane(state.x, state.memories, state.commands)
    interval_bounds = vmap_entrywise(intervals_of_lane)(k, lane, state.plant_draws) if state.watches else {}
    sums = vmap_entrywise(one_lane)(k, e, interval_bounds, state.streams, state.watches, state.tracking, state.x)
    streams, watches, tracking = sums
    return state._replace(streams=streams, watches=watches, tracking=tracking)


def squares(layout: Layout, p: GridPointParams, k: Array, state: State, e: dict[str, PerLane]) -> dict[str, PyTree]:
    """Return the normalized errors of tick k for observers that report a covariance."""

    def one_lane(k: Array, lane: Lane, e: dict[str, Array]) -> dict[str, PyTree]:
        return simulate_runs.normalized_errors(layout, p, k, lane.run, e)

    return vmap_entrywise(one_lane)(k, observer_view(layout, state), e)


# 4. control, 5. flow


def control(layout: Layout, p: GridPointParams, k: Array, state: State, draws: PyTree = ()) -> State:
    """Compute the command of tick k in a closed loop, and add its cost; `draws` are the network's random numbers."""
    if layout.controller is None:
        return state

    def one_lane(k: Array, lane: Lane, law: PyTree, effort: PyTree, draws: PyTree) -> PyTree:
        run = simulate_runs.command(layout, p, k, lane.run._replace(law=law), draws)
        if isinstance(p.weights, metrics.Weights):
            effort = simulate_runs.add_cost(layout, p, k, run, effort)
        return run.commands, run.law, effort

    lane = Lane(state.x, state.memories, state.commands)
    commands, law, effort = vmap_entrywise(one_lane)(k, lane, state.law, state.effort, draws)
    return state._replace(commands=commands, law=law, effort=effort)


def flow(layout: Layout, p: GridPointParams, k: Array, state: State, w: PerLane) -> State:
    """Move plant and observers from tick k to tick k + 1, the plant with the process noise w [n]."""

    def one_lane(k: Array, lane: Lane, plant_draws: PyTree, w: Array) -> PyTree:
        run = simulate_runs.flow(layout, p, params_of(layout, p, plant_draws), k, lane.run, w)
        return run.x, run.memories

    x, memories = vmap_entrywise(one_lane)(k, observer_view(layout, state)._replace(x=state.x), state.plant_draws, w)
    return state._replace(x=x, memories=memories)
