"""Samples and arrivals of many cells: the protocol functions at an event, and packets on their way with their directions.

Cells have events at ticks of their own: at a tick where some cell has one, all go through it, and what is not there changes
nothing.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.moments.bundle import Bundle, Carry, through
from pcbench.moments.given import Plan
from pcbench.simulation import steps
from pcbench.simulation.problem import Layout, Packet, State
from pcbench.simulation.steps import Row


class Flight(NamedTuple):
    """Packets on the network, in rings: bundles of arrays [..., rows, numbers, C]."""

    values: Bundle
    notes: Bundle  # of all observers, one after another


class Size(NamedTuple):
    """Of a batch."""

    cells: int
    directions: int  # that are compressed when they are full
    probes: int  # runs with noise

    @property
    def lead(self) -> tuple[int, int]:
        """Return the runs, and all directions: those that are compressed, and those of the runs with noise."""
        return 1 + self.probes, self.directions + self.probes


def sense(layout: Layout, p: Any, k: Array, state: State, noise: Array, fixed: Any) -> tuple[Array, Array]:
    """Return what is measured [q] and what is noted, of all observers."""
    y = steps.measure(layout, p, k, state, noise)
    notes = steps.note(layout, p, k, state)
    return y, jnp.concatenate([notes[label] for label, _ in layout.observers])


def jump(layout: Layout, p: Any, k: Array, state: State, packet: tuple[Array, Array], row: Any) -> Any:
    """Return the memories after a packet, where one arrives: `row` is (whether, Row)."""
    there, about = row
    found = jax.eval_shape(lambda state: steps.note(layout, p, k, state), state)
    each, at = {}, 0
    for label, _ in layout.observers:
        each[label] = packet[1][at : at + found[label].shape[0]]
        at += found[label].shape[0]
    after = steps.jump(layout, p, k, state, about, Packet(packet[0], each))
    return jax.tree.map(lambda a, b: jnp.where(there, a, b).astype(b.dtype), after, state.memories)


def happen(
    layout: Layout, carry: Carry, plan: Plan, k: Array, state: Bundle, flight: Flight, noise: Bundle
) -> tuple[Bundle, Flight]:
    """Let everything that the schedules have for tick k happen: sense and note, then deliver, the oldest packet first."""
    y, notes = _sensed(layout, carry, k, state, noise)
    measured = plan.useful[k][None] & (plan.number[k] >= 0)
    flight = Flight(
        _put(flight.values, plan.sense[k], y, measured, layout.ring),
        _put(flight.notes, plan.note[k], notes, plan.noted[k][None], layout.ring),
    )

    def deliver(slot: Array, carried: tuple[Bundle, Flight]) -> tuple[Bundle, Flight]:
        state, flight = carried
        number = plan.arrive[k, slot]
        place = jnp.where(number >= 0, number % layout.ring, layout.ring)
        runs, along = (tuple(_take(part, place) for part in parts) for parts in zip(*flight, strict=True))
        packet = Bundle(runs, tuple(x if x.size else None for x in along))
        row = Row(plan.fresh[k, slot], k - plan.believed[k, slot], plan.index[k, slot], plan.since[k, slot])
        row = row._replace(age=jnp.broadcast_to(row.age[None], row.fresh.shape))
        memories = through(partial(jump, layout), carry, k, state, packet, (number >= 0, row))
        state = Bundle(*(s._replace(memories=m) for s, m in zip(state, memories, strict=True)))
        return state, Flight(*(_faded(kind, place, plan.done[k, slot]) for kind in flight))

    return lax.fori_loop(0, plan.arrive.shape[1], deliver, (state, flight))


def launched(layout: Layout, carry: Carry, plan: Plan, state: Bundle, silent: Bundle, noises: list[Bundle]) -> Flight:
    """Return the rings before tick 0: packets taken before it have measured the start, and the start's note is in every place.

    `noises` are those of the packets taken before tick 0, in their order; `silent` is none.
    """
    zero = jnp.asarray(0)

    def ring(x: Array, times: float) -> Array:
        return jnp.repeat(x[..., None, :, :], layout.ring + 1, -3) * times

    y, notes = _sensed(layout, carry, zero, state, silent)
    values = Bundle(*(ring(x, 0.0) for x in y))
    for place, noise in enumerate(noises):
        there = jnp.where(jnp.any(plan.early[place] >= 0, 0), place, layout.ring)
        y, _ = _sensed(layout, carry, zero, state, noise)
        values = Bundle(*(_write(each, there, x) for each, x in zip(values, y, strict=True)))
    return Flight(values, Bundle(*(ring(x, 1.0) for x in notes)))


def _sensed(layout: Layout, carry: Carry, k: Array, state: Bundle, noise: Bundle) -> tuple[Bundle, Bundle]:
    """What is measured and what is noted, as arrays [..., numbers, C]."""
    found = through(partial(sense, layout), carry, k, state, noise)
    (y, notes), (along, noted) = found
    if noted is None:  # nothing is noted
        noted = jnp.zeros((along.shape[0], *notes.shape[1:]))
    return Bundle(y, along), Bundle(notes, noted)


def _put(flight: Bundle, number: Array, new: Bundle, used: Array, rows: int) -> Bundle:
    """Write a packet of each cell into its ring; directions of what nobody will use are left out."""
    place = jnp.where(number >= 0, number % rows, rows)
    return Bundle(
        _write(flight.runs, place, new.runs),
        _write(flight.directions, place, jnp.where(used[None], new.directions, 0.0)),
    )


def _write(ring: Array, place: Array, x: Array) -> Array:
    return jnp.where(_here(ring, place), x[..., None, :, :], ring)


def _take(ring: Array, place: Array) -> Array:
    at = jnp.broadcast_to(place, (*ring.shape[:-3], 1, *ring.shape[-2:]))
    return jnp.take_along_axis(ring, at, -3)[..., 0, :, :]


def _faded(ring: Bundle, place: Array, done: Array) -> Bundle:
    """Forget the directions of a packet of which nothing more will arrive: they would take up room."""
    return ring._replace(
        directions=jnp.where(_here(ring.directions, place) & done[None, None, None], 0.0, ring.directions)
    )


def _here(ring: Array, place: Array) -> Array:
    """Which rows are meant, [..., rows, 1, C] as the ring has axes."""
    here = jnp.arange(ring.shape[-3])[:, None, None] == place[None, None]
    return here.reshape(*(1 for _ in ring.shape[:-3]), *here.shape)
