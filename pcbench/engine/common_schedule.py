"""Samples and arrivals if all runs share one schedule: all lanes have the same events at a tick.

`simulation.schedule` decides which measurement arrives when. Its integer arrays (a `Schedule`) are traced, so one compiled
program covers every period and delay. Packets in flight are kept in rings by packet number.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.engine import lane_array
from pcbench.engine.initial_state import initial_lanes
from pcbench.engine.steps import ApplyEvents, any_is_notified, jump, measure, notify_sampled, snapshot
from pcbench.simulation import measurements
from pcbench.simulation.measurements import Noise
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout, Packet, PerLane, Snapshots, State


def prepare(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> tuple[ApplyEvents, State]:
    """Return the function that applies a tick's events to a block of runs, and the state before tick 0."""
    noise = measurements.noise_sampler(p, root_seed, seeds, barrier=True)
    state = with_rings(layout, p, noise, initial_lanes(layout, p, root_seed, seeds))
    return partial(apply_events, layout, p, noise), state


def with_rings(layout: Layout, p: GridPointParams, noise: Noise, state: State) -> State:
    """Return the state with rings of ring + 1 packets, including packets taken before tick 0, which measure x(0).

    A packet whose assumed sampling tick is before tick 0 carries the snapshot of the initial state.
    """
    value_forms, channels = state.flight.values, list(range(p.noise_std.shape[0]))
    values, snapshots = jax.tree.map(lambda v: jnp.broadcast_to(v, (layout.ring + 1, *jnp.shape(v))), state.flight)

    def write(rings: PyTree, packet: tuple[Array, Array]) -> tuple[PyTree, None]:
        place, numbers = packet
        draws = lane_array.split(noise(channels, numbers))
        y = lane_array.match_form(measure(layout, p, jnp.asarray(0), state, draws), value_forms, layout.width)
        return jax.tree.map(lambda ring, v: lax.dynamic_update_index_in_dim(ring, v, place, 0), rings, y), None

    if count := p.schedule.early.shape[0]:
        values, _ = lax.scan(write, values, (jnp.arange(count), p.schedule.early))
    return state._replace(flight=Packet(values, snapshots))


def apply_events(layout: Layout, p: GridPointParams, noise: Noise, k: Array, state: State) -> State:
    """Apply all events of tick k: sample and snapshot, then deliver, the oldest packet first.

    Only one packet passes through a `cond`, never the ring, which `cond` would copy. If there is no packet, the last ring
    entry is written, which nothing reads.
    """
    schedule, channels = p.schedule, list(range(p.noise_std.shape[0]))

    def write(rings: PyTree, number: Array, make: Any) -> PyTree:
        last = jax.tree.map(lambda ring: ring[layout.ring], rings)
        new = lax.cond(number >= 0, lambda: lane_array.match_form(make(), last, layout.width), lambda: last)
        place = jnp.where(number >= 0, number % layout.ring, layout.ring)
        return jax.tree.map(lambda ring, v: lax.dynamic_update_index_in_dim(ring, v, place, 0), rings, new)

    def sense() -> PerLane:
        return measure(layout, p, k, state, lane_array.split(noise(channels, schedule.sample[k])))

    def take_snapshots() -> Snapshots:
        return snapshot(layout, p, k, state)

    values, snapshots = state.flight
    flight = Packet(write(values, schedule.sense[k], sense), write(snapshots, schedule.snapshot[k], take_snapshots))
    for i in range(schedule.extra_snapshots.shape[1]):
        flight = flight._replace(snapshots=write(flight.snapshots, schedule.extra_snapshots[k, i], take_snapshots))

    def notify_observers() -> PyTree:
        memories = notify_sampled(layout, p, k, state, schedule.sample[k] >= 0)
        return lane_array.match_form(memories, state.memories, layout.width)

    def deliver(slot: Array, memories: PyTree) -> PyTree:
        number = schedule.arrive[k, slot]
        packet = jax.tree.map(partial(lax.dynamic_index_in_dim, index=number % layout.ring, keepdims=False), flight)
        mask, age = schedule.mask[k, slot], jnp.full(schedule.mask[k, slot].shape, k - schedule.timestamp[k, slot])
        info = ArrivalInfo(mask, age, schedule.number[k, slot], schedule.ticks_since_arrival[k, slot])

        def use_packet(memories: PyTree) -> PyTree:
            new = jump(layout, p, k, state._replace(memories=memories), info, packet)
            return lane_array.match_form(new, memories, layout.width)

        return lax.cond(number >= 0, use_packet, lambda memories: memories, memories)

    if any_is_notified(layout):
        state = state._replace(memories=lax.cond(schedule.sense[k] >= 0, notify_observers, lambda: state.memories))
    memories = lax.fori_loop(0, schedule.arrive.shape[1], deliver, state.memories)
    return state._replace(memories=memories, flight=flight)
