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
from pcbench.engine.initial_state import begin
from pcbench.engine.steps import any_is_notified, flow, jump, measure, notify_sampled, snapshot
from pcbench.simulation import measurements
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.event_table import EventTable, event_table
from pcbench.simulation.schedule.random_times import ClockParams
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout, Notes, Packet, State

CHUNK = 32  # lanes extracted together; 128 take 1.2 times as long with jitter, 1.6 times with out-of-sequence samples


class Queue(NamedTuple):
    """Events of all runs in order of time, with room for one more chunk; E rows of the event table."""

    when: Array  # [E L + CHUNK] tick E + slot
    what: Array  # [E L + CHUNK] row L + run


class Progress(NamedTuple):
    """How many events of all runs are complete."""

    sensed: Array
    noted: Array
    arrived: Array


class Flight(NamedTuple):
    """Packets on the network, in rings by row of each run's event table, and the progress of the queues."""

    values: Array  # [q, R, L]
    notes: Array  # [size of all snapshots, R, L]
    done: Progress


class Chunk(NamedTuple):
    """Simultaneous events, at most one per lane."""

    lane: Array  # [CHUNK]; beyond the last lane: no event
    row: Array  # [CHUNK] of the event table
    size: Array  # number of events


class Events(NamedTuple):
    """All events of a block of runs, and the packing of memories. E rows of the event table, M samples."""

    layout: Layout
    p: GridPointParams
    times: ClockParams
    agenda: EventTable
    taken: Queue
    noting: Queue
    arrivals: Queue
    noise: list[Array]  # by channel [M, L], standard normal; then the other draws of a sample, by channel
    form: packing.Packing
    first_notes: Notes  # of the initial state; all snapshots have this shape

    @property
    def rows(self) -> int:
        """Return E, the rows of the event table."""
        return len(self.agenda.arrives)

    def happen(self, k: Array, state: State) -> State:
        """Apply all events of tick k: sample and snapshot, then deliver, the oldest packet of a run first."""
        return _deliver(self, k, _take(self, k, state))

    def following(self, k: Array, state: State) -> Array:
        """Return the tick of the next event of any run after tick k."""
        done = state.flight.done
        due = jnp.stack([self.taken.when[done.sensed], self.noting.when[done.noted], self.arrivals.when[done.arrived]])
        return due.min() // self.rows


def prepare(layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array) -> tuple[Events, State]:
    """Return the events of a block of runs, and the state before tick 0 with packed memories."""
    times: PyTree = p.schedule
    plan, zero, state = event_table(times, root_seed, seeds), jnp.asarray(0), begin(layout, p, root_seed, seeds)
    rows, none = len(plan.arrives), jnp.zeros(0)  # no process noise: it does not enter a memory
    taken = _queue(plan.taken * rows)
    stamped = _queue(plan.timestamp * rows) if times.stamp else taken._replace(when=taken.when - times.error * rows)
    events = Events(
        layout=layout,
        p=p,
        times=times,
        agenda=plan,
        taken=taken,
        noting=stamped,
        arrivals=_queue(plan.arrives * rows + plan.slot),
        noise=_noise(p, times, root_seed, seeds),
        form=packing.packing(
            lambda m: flow(layout, p, zero, state._replace(memories=m), none).memories, state.memories
        ),
        first_notes=snapshot(layout, p, zero, state),
    )
    early = (stamped.when < 0).sum()  # assumed to be from before tick 0: the snapshot is that of the initial state
    rings = _rings(layout, state.flight.values), _rings(layout, events.first_notes)
    flight = Flight(*rings, Progress(zero, early, zero))
    return events, state._replace(memories=events.form.pack(state.memories), flight=flight)


def _take(events: Events, k: Array, state: State) -> State:
    """Take the samples of tick k and the snapshots with this timestamp, CHUNK runs at a time."""
    taken, noting, now, telling = events.taken, events.noting, k * events.rows, any_is_notified(events.layout)

    def due(c: tuple[Flight, PyTree]) -> Array:
        return (taken.when[c[0].done.sensed] == now) | (noting.when[c[0].done.noted] == now)

    def some(c: tuple[Flight, PyTree]) -> tuple[Flight, PyTree]:
        (flight, memories), done = c, c[0].done
        sensed, noted = (_chunk(q, n, now, events.layout) for q, n in ((taken, done.sensed), (noting, done.noted)))
        values = _write(flight.values, sensed, _measure_runs(events, k, state, sensed))
        notes = _write(flight.notes, noted, snapshot(events.layout, events.p, k, _taken_out(events, state, noted)))
        if telling:
            memories = _notify_observers(events, k, state._replace(memories=memories), sensed)
        done = Progress(done.sensed + sensed.size, done.noted + noted.size, done.arrived)
        return Flight(values, notes, done), memories

    flight, memories = lax.while_loop(due, some, (state.flight, state.memories if telling else ()))
    return state._replace(flight=flight, memories=memories if telling else state.memories)


def _measure_runs(events: Events, k: Array, state: State, c: Chunk) -> PyTree:
    number = _of_channels(events, events.agenda.number, c.row, c.lane)
    noise = jnp.stack([_at(each, number[i % len(number)], c.lane) for i, each in enumerate(events.noise)])
    x, drawn = lane_array.pick((state.x, state.plant_draws), c.lane)
    return measure(events.layout, events.p, k, state._replace(x=x, plant_draws=drawn), lane_array.split(noise))


def _notify_observers(events: Events, k: Array, state: State, c: Chunk) -> packing.PackedMemory:
    """Return the memories after the observers of some runs were notified of their samples."""
    mine, number = _taken_out(events, state, c), _of_channels(events, events.agenda.number, c.row, c.lane)
    after = notify_sampled(events.layout, events.p, k, mine, lane_array.split(number >= 0))
    return packing.put_back(
        state.memories, events.form.pack(lane_array.match_form(after, mine.memories, CHUNK)), c.lane
    )


def _deliver(events: Events, k: Array, state: State) -> State:
    """Deliver every packet that arrives at tick k, CHUNK runs at a time, in order."""
    arrivals, last, flight = events.arrivals, (k + 1) * events.rows, state.flight

    def some(c: tuple[Array, packing.PackedMemory]) -> tuple[Array, packing.PackedMemory]:
        coming = _chunk(arrivals, c[0], arrivals.when[c[0]], events.layout)
        return c[0] + coming.size, _apply_arrivals(events, k, state._replace(memories=c[1]), coming)

    arrived, memories = lax.while_loop(
        lambda c: arrivals.when[c[0]] < last, some, (flight.done.arrived, state.memories)
    )
    return state._replace(memories=memories, flight=flight._replace(done=flight.done._replace(arrived=arrived)))


def _apply_arrivals(events: Events, k: Array, state: State, c: Chunk) -> packing.PackedMemory:
    """Return the memories after the arrivals of some runs."""
    layout, flight = events.layout, state.flight
    which = _at(events.agenda.packet, c.row, c.lane)
    values, notes = (ring.at[:, which % layout.ring, c.lane].get(mode="clip") for ring in flight[:2])
    packet = Packet(lane_array.split(values), _unflat(notes, events.first_notes))
    mine = _taken_out(events, state, c)
    after = jump(layout, events.p, k, mine, _row(events, k, c, which), packet)
    return packing.put_back(
        state.memories, events.form.pack(lane_array.match_form(after, mine.memories, CHUNK)), c.lane
    )


def _taken_out(events: Events, state: State, c: Chunk) -> State:
    """Return the observers' view of some runs: their memories, and in a closed loop their commands."""
    mine = state._replace(memories=events.form.whole(packing.pick(state.memories, c.lane)))
    if not events.layout.controller:
        return mine
    commands, watches = lane_array.pick((state.commands, state.watches), c.lane)
    return mine._replace(commands=commands, watches=watches)


def _noise(p: GridPointParams, times: ClockParams, root_seed: Array, seeds: Array) -> list[Array]:
    """Return the noise of every sample of each channel before scaling, [M, L], with the draws of a common schedule.

    Drawn in advance: the hash of a draw takes longer for a chunk of lanes than its jump.
    """
    noise, index = measurements.noise_sampler(p, root_seed, seeds, apart=True), jnp.arange(times.due.shape[1])
    each = [lax.map(lambda i, j=j: noise([j], i[None]), index) for j in range(p.noise_std.shape[0])]
    return [rows[:, i] for i in range(each[0].shape[1]) for rows in each]


def _queue(when: Array) -> Queue:
    order = jnp.argsort(when.reshape(-1), stable=True)
    end = jnp.full(CHUNK, NEVER * len(when))
    return Queue(jnp.concatenate([when.reshape(-1)[order], end]), jnp.concatenate([order, jnp.zeros_like(end)]))


def _chunk(queue: Queue, done: Array, when: Array, layout: Layout) -> Chunk:
    """Return the next events of a queue that are due at `when`."""
    due, what = (lax.dynamic_slice_in_dim(a, done, CHUNK) for a in queue)
    together = due == when
    return Chunk(jnp.where(together, what % layout.width, layout.width), what // layout.width, together.sum())


def _row(events: Events, k: Array, c: Chunk, which: Array) -> ArrivalInfo:
    """Return mask, age and sample numbers of the packets that arrive."""
    plan, number = events.agenda, _of_channels(events, events.agenda.number, which, c.lane)
    return ArrivalInfo(
        mask=lane_array.split(_of_channels(events, plan.brings, c.row, c.lane)),
        age=lane_array.split(jnp.broadcast_to(k - jnp.maximum(_at(plan.timestamp, which, c.lane), 0), number.shape)),
        number=lane_array.split(number),
        ticks_since_arrival=lane_array.split(_at(plan.ticks_since_arrival, c.row, c.lane)),
    )


def _of_channels(events: Events, table: Array, row: Array, lane: Array) -> Array:
    """Return entries of a table by clock [C, E, L], for each channel: [q, CHUNK]."""
    return table.at[:, row, lane].get(mode="clip")[events.times.clock_of]


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
    rest = iter(numbers)

    def one(leaf: PyTree) -> PyTree:
        size = math.prod(leaf.shape)
        return lane_array.lanes_of(leaf.shape, [next(rest) for _ in range(size)]) if size else leaf

    return jax.tree.map(one, like, is_leaf=lane_array.is_lanes)


def _rings(layout: Layout, packet: PyTree) -> Array:
    numbers = _flat(packet, layout.width)
    return jnp.broadcast_to(numbers[:, None], (len(numbers), layout.ring, layout.width))


def _write(rings: Array, c: Chunk, packet: PyTree) -> Array:
    """Write packets to their places in rings [numbers, R, L]."""
    return rings.at[:, c.row % rings.shape[1], c.lane].set(_flat(packet, CHUNK), mode="drop")
