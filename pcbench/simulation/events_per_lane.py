"""Events on schedules of their own: at a tick a few lanes sense or jump, the others do not.

With random sampling some lane has an event at nearly every tick. All events of a block of runs are therefore sorted by time,
and at each tick the lanes that have one are taken out, `CHUNK` of them at most at a time, do it, and are put back; the flow
between is that of a shared schedule. A run has the numbers it has alone on its own schedule (`events_shared`).
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import draws, lanes
from pcbench.simulation.events_shared import Events
from pcbench.simulation.lanes import packed
from pcbench.simulation.problem import Layout, Problem, State
from pcbench.simulation.schedule import per_lane
from pcbench.simulation.schedule.per_lane import Agenda
from pcbench.simulation.schedule.shared import NEVER
from pcbench.simulation.steps import Row, advance, begin, hand_over, measure, note

CHUNK = 32  # lanes taken out together: with 128 jitter costs 1.2 and overtaking 1.6 times as much


class Queue(NamedTuple):
    """Events of all runs in order of time, and room for one more chunk at the end; E an agenda's length."""

    when: Array  # [E L + CHUNK] tick E + slot
    what: Array  # [E L + CHUNK] row L + run


class Flight(NamedTuple):
    """Packets on the network, in rings by row of each run's agenda; and how many events of all runs are done."""

    values: Array  # [q, R, L]
    notes: Array  # [numbers noted by all observers, R, L]
    sensed: Array
    noted: Array
    arrived: Array


class Chunk(NamedTuple):
    """Events that happen together, no two of them in one lane."""

    lane: Array  # [CHUNK] beyond the last lane: no event
    row: Array  # [CHUNK] of the agenda
    size: Array  # how many there are


def prepare(layout: Layout, p: Problem, root_seed: Array, seeds: Array) -> tuple[Events, State]:
    """Return the events of a block of runs, and the state before tick 0."""
    plan, drawn = per_lane.agenda(p.schedule, root_seed, seeds), _noise(p, root_seed, seeds)
    rows, zero, error = len(plan.arrives), jnp.asarray(0), p.schedule.error
    none = jnp.zeros(0)  # without process noise: it moves the plant, no memory
    taken, arrivals = _queue(plan.samples[0] * rows), _queue(plan.arrives * rows + plan.slot)
    state = begin(layout, p, root_seed, seeds)
    form = packed.packing(lambda m: advance(layout, p, zero, state._replace(memories=m), none).memories, state.memories)
    first_notes = note(layout, p, zero, state.memories)
    early = (taken.when // rows < error).sum()  # believed to be from before tick 0: the start is noted
    flight = Flight(_rings(layout, state.flight[0]), _rings(layout, first_notes), zero, early, zero)

    def happen(k: Array, state: State) -> tuple[State, Array]:
        f = state.flight

        def sense(c: Chunk, rings: Array) -> Array:
            number = _at(plan.samples[2], c.row, c.lane)
            noise = jnp.stack([_at(each, number, c.lane) for each in drawn])
            x, own = lanes.pick((state.x, state.own), c.lane)
            return _write(rings, c, measure(layout, p, k, x, own, lanes.split(noise)))

        def take_note(c: Chunk, rings: Array) -> Array:
            return _write(rings, c, note(layout, p, k, form.whole(packed.pick(state.memories, c.lane))))

        def deliver(c: Chunk, kept: Any) -> Any:
            which = _at(plan.which, c.row, c.lane)
            value, noted = (ring.at[:, which % layout.ring, c.lane].get(mode="clip") for ring in (values, notes))
            mine = form.whole(packed.pick(kept, c.lane))
            packet = lanes.split(value), _unflat(noted, first_notes)
            jumped = hand_over(layout, p, k, _row(p, plan, k, c, which), packet, mine)
            return packed.put_back(kept, form.pack(lanes.like(jumped, mine, CHUNK)), c.lane)

        def take(c: tuple[Any, ...]) -> tuple[Any, ...]:
            sensing, noting = _chunk(taken, c[0], k * rows, layout), _chunk(taken, c[1], (k + error) * rows, layout)
            return c[0] + sensing.size, c[1] + noting.size, sense(sensing, c[2]), take_note(noting, c[3])

        def taking(c: tuple[Any, ...]) -> Array:
            return (taken.when[c[0]] == k * rows) | (taken.when[c[1]] == (k + error) * rows)

        sensed, noted, values, notes = lax.while_loop(taking, take, (f.sensed, f.noted, f.values, f.notes))

        def hand(c: tuple[Any, ...]) -> tuple[Any, ...]:
            coming = _chunk(arrivals, c[0], arrivals.when[c[0]], layout)
            return c[0] + coming.size, deliver(coming, c[1])

        last = (k + 1) * rows
        arrived, memories = lax.while_loop(lambda c: arrivals.when[c[0]] < last, hand, (f.arrived, state.memories))
        due = jnp.stack([taken.when[sensed], taken.when[noted] - error * rows, arrivals.when[arrived]])
        flight = Flight(values, notes, sensed, noted, arrived)
        return state._replace(memories=memories, flight=flight), due.min() // rows

    return Events(happen, form.whole, form.moved), state._replace(memories=form.pack(state.memories), flight=flight)


def _noise(p: Problem, root_seed: Array, seeds: Array) -> list[Array]:
    """Standard normal noise of every sample of each channel, [M, L]: the draws of a shared schedule.

    Drawn beforehand: the hash behind a draw costs a chunk of lanes more than its jump.
    """
    keys = draws.run_keys(root_seed, seeds, "measurement", p.noise_std.shape[0])
    index = jnp.arange(p.schedule.due.shape[1])
    return [lax.map(lambda i, key=key: draws.normals([key], i[None])[0], index) for key in keys]


def _queue(when: Array) -> Queue:
    order = jnp.argsort(when.reshape(-1), stable=True)
    end = jnp.full(CHUNK, NEVER * len(when))
    return Queue(jnp.concatenate([when.reshape(-1)[order], end]), jnp.concatenate([order, jnp.zeros_like(end)]))


def _chunk(queue: Queue, done: Array, when: Array, layout: Layout) -> Chunk:
    """The next events of a queue, as far as they are due exactly `when`."""
    due, what = (lax.dynamic_slice_in_dim(a, done, CHUNK) for a in queue)
    together = due == when
    return Chunk(jnp.where(together, what % layout.width, layout.width), what // layout.width, together.sum())


def _row(p: Problem, plan: Agenda, k: Array, c: Chunk, which: Array) -> Row:
    """What is known of the packets that arrive."""
    taken, clock, number = plan.samples.at[:, which, c.lane].get(mode="clip")
    age, clocks = k - jnp.maximum(taken - p.schedule.error, 0), p.schedule.clock_of
    same = (len(clocks), CHUNK)
    return Row(
        fresh=lanes.split(clock[None] == clocks[:, None]),
        age=lanes.split(jnp.broadcast_to(age, same)),
        number=lanes.split(jnp.broadcast_to(number, same)),
        since=lanes.split(_at(plan.since, c.row, c.lane)),
    )


def _at(table: Array, row: Array, lane: Array) -> Array:
    """Entries of a table [E, L]."""
    return table.at[row, lane].get(mode="clip")


def _flat(packet: Any, width: int) -> Array:
    """Every number of a packet, [numbers, L]."""
    parts = map(lanes.entries, jax.tree.leaves(lanes.everywhere(packet, width), is_leaf=lanes.is_lanes))
    entries = [entry for part in parts if lanes.is_lanes(part) for entry in part.parts.flat]
    return jnp.stack(entries) if entries else jnp.zeros((0, width))


def _unflat(numbers: Array, like: Any) -> Any:
    """Undo `_flat`, in the shape of `like`."""
    rest = iter(numbers)

    def one(leaf: Any) -> Any:
        size = math.prod(leaf.shape)
        return lanes.lanes_of(leaf.shape, [next(rest) for _ in range(size)]) if size else leaf

    return jax.tree.map(one, like, is_leaf=lanes.is_lanes)


def _rings(layout: Layout, packet: Any) -> Array:
    numbers = _flat(packet, layout.width)
    return jnp.broadcast_to(numbers[:, None], (len(numbers), layout.ring, layout.width))


def _write(rings: Array, c: Chunk, packet: Any) -> Array:
    """Write packets to their places in rings [numbers, R, L]."""
    return rings.at[:, c.row % rings.shape[1], c.lane].set(_flat(packet, CHUNK), mode="drop")
