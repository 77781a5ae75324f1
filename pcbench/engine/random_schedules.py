"""Samples and arrivals if each run has its own schedule: at a tick only a few lanes have an event.

`simulation.schedule` decides which measurement arrives when. With random sampling some lane has an event at nearly every tick.
The events of a block of runs are sorted by time (`event_table`). At each tick the lanes with an event are extracted, at most
`CHUNK` at a time, and written back. A run has the same numbers as alone.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.engine import lane_array, packing
from pcbench.engine.initial_state import initial_lanes
from pcbench.engine.steps import any_is_notified, flow, jump, measure, notify_sampled, snapshot
from pcbench.simulation import measurements
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.event_table import EventTable, event_table
from pcbench.simulation.schedule.random_times import ClockParams
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout, Packet, Snapshots, State

CHUNK = 32  # lanes extracted together; 128 take 1.2 times as long with jitter, 1.6 times with out-of-sequence samples


class Queue(NamedTuple):
    """Events of all runs in order of time, with room for one more chunk; E rows of the event table."""

    time: Array  # [E L + CHUNK] tick E + slot
    event: Array  # [E L + CHUNK] row L + run


class Progress(NamedTuple):
    """How many events of all runs are complete."""

    samples: Array
    snapshots: Array
    arrivals: Array


class Flight(NamedTuple):
    """Packets on the network, in rings by row of each run's event table, and the progress of the queues."""

    values: Array  # [q, R, L]
    snapshots: Array  # [size of all snapshots, R, L]
    progress: Progress


class Chunk(NamedTuple):
    """Simultaneous events, at most one per lane."""

    lane: Array  # [CHUNK]; beyond the last lane: no event
    row: Array  # [CHUNK] of the event table
    size: Array  # number of events


class Events(NamedTuple):
    """All events of a block of runs, and the packing of memories. E rows of the event table, M samples."""

    layout: Layout
    p: GridPointParams
    clocks: ClockParams
    table: EventTable
    samples: Queue
    snapshots: Queue
    arrivals: Queue
    noise: list[Array]  # by channel [M, L], standard normal; then the other draws of a sample, by channel
    memory_packing: packing.Packing
    first_snapshots: Snapshots  # of the initial state; all snapshots have this shape

    @property
    def rows(self) -> int:
        """Return E, the rows of the event table."""
        return len(self.table.arrives)

    def apply(self, k: Array, state: State) -> State:
        """Apply all events of tick k: sample and snapshot, then deliver, the oldest packet of a run first."""
        return _deliver(self, k, _take_samples(self, k, state))

    def next_event(self, k: Array, state: State) -> Array:
        """Return the tick of the next event of any run after tick k."""
        progress = state.flight.progress
        queues = self.samples, self.snapshots, self.arrivals  # in the order of `Progress`
        return jnp.stack([queue.time[i] for queue, i in zip(queues, progress, strict=True)]).min() // self.rows


def prepare(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> tuple[Events, State]:
    """Return the events of a block of runs, and the state before tick 0 with packed memories."""
    clocks: PyTree = p.schedule
    table, zero, state = (
        event_table(clocks, root_seed, seeds),
        jnp.asarray(0),
        initial_lanes(layout, p, root_seed, seeds),
    )
    rows, no_noise = len(table.arrives), jnp.zeros(0)  # no process noise: it does not enter a memory
    samples = _queue(table.sampling_ticks * rows)
    shift = clocks.error * rows
    snapshots = _queue(table.timestamp * rows) if clocks.stamp else samples._replace(time=samples.time - shift)
    events = Events(
        layout=layout,
        p=p,
        clocks=clocks,
        table=table,
        samples=samples,
        snapshots=snapshots,
        arrivals=_queue(table.arrives * rows + table.slot),
        noise=_noise(p, clocks, root_seed, seeds),
        memory_packing=packing.find_packing(
            lambda m: flow(layout, p, zero, state._replace(memories=m), no_noise).memories, state.memories
        ),
        first_snapshots=snapshot(layout, p, zero, state),
    )
    n_early = (snapshots.time < 0).sum()  # assumed to be from before tick 0: the snapshot is that of the initial state
    packet_rings = _rings(layout, state.flight.values), _rings(layout, events.first_snapshots)
    flight = Flight(*packet_rings, Progress(zero, n_early, zero))
    return events, state._replace(memories=events.memory_packing.pack(state.memories), flight=flight)


def _take_samples(events: Events, k: Array, state: State) -> State:
    """Take the samples of tick k and the snapshots with this timestamp, CHUNK runs at a time."""
    samples, snapshots, instant = events.samples, events.snapshots, k * events.rows
    notifies = any_is_notified(events.layout)

    def due(c: tuple[Flight, PyTree]) -> Array:
        return (samples.time[c[0].progress.samples] == instant) | (snapshots.time[c[0].progress.snapshots] == instant)

    def step(c: tuple[Flight, PyTree]) -> tuple[Flight, PyTree]:
        (flight, memories), progress = c, c[0].progress
        sample_chunk, snapshot_chunk = (
            _chunk(q, n, instant, events.layout)
            for q, n in ((samples, progress.samples), (snapshots, progress.snapshots))
        )
        values = _write(flight.values, sample_chunk, _measure_runs(events, k, state, sample_chunk))
        view = _view_of_runs(events, state, snapshot_chunk)
        ring = _write(flight.snapshots, snapshot_chunk, snapshot(events.layout, events.p, k, view))
        if notifies:
            memories = _notify_observers(events, k, state._replace(memories=memories), sample_chunk)
        progress = Progress(
            progress.samples + sample_chunk.size, progress.snapshots + snapshot_chunk.size, progress.arrivals
        )
        return Flight(values, ring, progress), memories

    flight, memories = lax.while_loop(due, step, (state.flight, state.memories if notifies else ()))
    return state._replace(flight=flight, memories=memories if notifies else state.memories)


def _measure_runs(events: Events, k: Array, state: State, c: Chunk) -> PyTree:
    number = _of_channels(events, events.table.number, c.row, c.lane)
    noise = jnp.stack([_at(v, number[i % len(number)], c.lane) for i, v in enumerate(events.noise)])
    x, plant_draws = lane_array.pick((state.x, state.plant_draws), c.lane)
    return measure(events.layout, events.p, k, state._replace(x=x, plant_draws=plant_draws), lane_array.split(noise))


def _notify_observers(events: Events, k: Array, state: State, c: Chunk) -> packing.PackedMemory:
    """Return the memories after the observers of some runs were notified of their samples."""
    view, number = _view_of_runs(events, state, c), _of_channels(events, events.table.number, c.row, c.lane)
    memories = notify_sampled(events.layout, events.p, k, view, lane_array.split(number >= 0))
    return packing.put_back(
        state.memories, events.memory_packing.pack(lane_array.match_form(memories, view.memories, CHUNK)), c.lane
    )


def _deliver(events: Events, k: Array, state: State) -> State:
    """Deliver every packet that arrives at tick k, CHUNK runs at a time, in order."""
    arrivals, last, flight = events.arrivals, (k + 1) * events.rows, state.flight

    def step(c: tuple[Array, packing.PackedMemory]) -> tuple[Array, packing.PackedMemory]:
        chunk = _chunk(arrivals, c[0], arrivals.time[c[0]], events.layout)
        return c[0] + chunk.size, _apply_arrivals(events, k, state._replace(memories=c[1]), chunk)

    position, memories = lax.while_loop(
        lambda c: arrivals.time[c[0]] < last, step, (flight.progress.arrivals, state.memories)
    )
    return state._replace(
        memories=memories, flight=flight._replace(progress=flight.progress._replace(arrivals=position))
    )


def _apply_arrivals(events: Events, k: Array, state: State, c: Chunk) -> packing.PackedMemory:
    """Return the memories after the arrivals of some runs."""
    layout, flight = events.layout, state.flight
    packet_row = _at(events.table.packet, c.row, c.lane)
    values, snapshots = (ring.at[:, packet_row % layout.ring, c.lane].get(mode="clip") for ring in flight[:2])
    packet = Packet(lane_array.split(values), _unflat(snapshots, events.first_snapshots))
    view = _view_of_runs(events, state, c)
    memories = jump(layout, events.p, k, view, _arrival_info(events, k, c, packet_row), packet)
    return packing.put_back(
        state.memories, events.memory_packing.pack(lane_array.match_form(memories, view.memories, CHUNK)), c.lane
    )


def _view_of_runs(events: Events, state: State, c: Chunk) -> State:
    """Return the observers' view of some runs: their memories, and in a closed loop their commands."""
    view = state._replace(memories=events.memory_packing.unpack(packing.pick(state.memories, c.lane)))
    if not events.layout.controller:
        return view
    commands, watches = lane_array.pick((state.commands, state.watches), c.lane)
    return view._replace(commands=commands, watches=watches)


def _noise(p: GridPointParams, clocks: ClockParams, root_seed: Array, seeds: Array) -> list[Array]:
    """Return the noise of every sample of each channel before scaling, [M, L], with the draws of a common schedule.

    Drawn in advance: the hash of a draw takes longer for a chunk of lanes than its jump.
    """
    noise, samples = measurements.noise_sampler(p, root_seed, seeds, barrier=True), jnp.arange(clocks.due.shape[1])
    channels = [lax.map(lambda i, j=j: noise([j], i[None]), samples) for j in range(p.noise_std.shape[0])]
    return [rows[:, i] for i in range(channels[0].shape[1]) for rows in channels]


def _queue(time: Array) -> Queue:
    order = jnp.argsort(time.reshape(-1), stable=True)
    end = jnp.full(CHUNK, NEVER * len(time))
    return Queue(jnp.concatenate([time.reshape(-1)[order], end]), jnp.concatenate([order, jnp.zeros_like(end)]))


def _chunk(queue: Queue, start: Array, time: Array, layout: Layout) -> Chunk:
    """Return the next events of a queue that are due at `time`."""
    due, events = (lax.dynamic_slice_in_dim(a, start, CHUNK) for a in queue)
    is_due = due == time
    return Chunk(jnp.where(is_due, events % layout.width, layout.width), events // layout.width, is_due.sum())


def _arrival_info(events: Events, k: Array, c: Chunk, packet_row: Array) -> ArrivalInfo:
    """Return mask, age and sample numbers of the packets that arrive."""
    table, number = events.table, _of_channels(events, events.table.number, packet_row, c.lane)
    return ArrivalInfo(
        mask=lane_array.split(_of_channels(events, table.mask, c.row, c.lane)),
        age=lane_array.split(
            jnp.broadcast_to(k - jnp.maximum(_at(table.timestamp, packet_row, c.lane), 0), number.shape)
        ),
        number=lane_array.split(number),
        ticks_since_arrival=lane_array.split(_at(table.ticks_since_arrival, c.row, c.lane)),
    )


def _of_channels(events: Events, table: Array, row: Array, lane: Array) -> Array:
    """Return entries of a table by clock [C, E, L], for each channel: [q, CHUNK]."""
    return table.at[:, row, lane].get(mode="clip")[events.clocks.clock_of]


def _at(table: Array, row: Array, lane: Array) -> Array:
    """Return entries of a table [E, L]."""
    return table.at[row, lane].get(mode="clip")


def _flat(packet: PyTree, width: int) -> Array:
    """Return all numbers of a packet, [numbers, L]."""
    leaves = [x for x in jax.tree.leaves(packet, is_leaf=lane_array.is_lanes) if math.prod(x.shape)]
    entries = [entry for x in leaves for entry in lane_array.to_form(x, lane_array.ENTRIES, width).parts.flat]
    return jnp.stack(entries) if entries else jnp.zeros((0, width))


def _unflat(numbers: Array, like: PyTree) -> PyTree:
    """Return the packet of numbers from `_flat`, in the shape of `like`."""
    rows = iter(numbers)

    def one(leaf: PyTree) -> PyTree:
        size = math.prod(leaf.shape)
        return lane_array.lanes_of(leaf.shape, [next(rows) for _ in range(size)]) if size else leaf

    return jax.tree.map(one, like, is_leaf=lane_array.is_lanes)


def _rings(layout: Layout, packet: PyTree) -> Array:
    numbers = _flat(packet, layout.width)
    return jnp.broadcast_to(numbers[:, None], (len(numbers), layout.ring, layout.width))


def _write(rings: Array, c: Chunk, packet: PyTree) -> Array:
    """Write packets to their places in rings [numbers, R, L]."""
    return rings.at[:, c.row % rings.shape[1], c.lane].set(_flat(packet, CHUNK), mode="drop")
