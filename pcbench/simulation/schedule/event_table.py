"""What happens in every run whose sampling is random, in order: packets that are taken, and arrivals."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.simulation.schedule import random_times
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.random_times import ClockParams


class EventTable(NamedTuple):
    """What happens in every run: E rows, one per sample of each clock in the order they are taken; L runs, C clocks.

    Samples of one tick are one packet, in the row of the first of them; of a packet what arrives at one tick is one arrival, in
    the row of the first of those. The other rows are at NEVER.
    """

    taken: Array  # [E, L] tick of each packet
    number: Array  # [C, E, L] which sample of each clock is in the packet; -1: none
    believed: Array  # [E, L] tick at which the observers believe a packet was taken, which may be before 0
    arrives: Array  # [E, L] tick of the first, second ... arrival; NEVER: lost
    which: Array  # [E, L] the row of the packet that arrives
    brings: Array  # [C, E, L] whether each clock's sample is in the arrival
    slot: Array  # [E, L] how many arrive before it at the same tick
    ticks_since_arrival: Array  # [E, L] ticks since the last tick at which anything arrived (from 0 before the first)


def event_table(t: ClockParams, root_seed: Array, seeds: Array) -> EventTable:
    """Return what happens in every run, in order: at one tick the older packet arrives first."""
    each = [random_times.clock_times(t, c, root_seed, seeds) for c in range(t.due.shape[0])]
    taken, arrives = (jnp.concatenate(part) for part in zip(*each, strict=True))
    clock = jnp.concatenate([jnp.full_like(own, c) for c, (own, _) in enumerate(each)])
    number = jnp.concatenate([jnp.broadcast_to(jnp.arange(len(own))[:, None], own.shape) for own, _ in each])
    order = jnp.argsort(taken, axis=0, stable=True)
    taken, arrives, clock, number = (jnp.take_along_axis(a, order, 0) for a in (taken, arrives, clock, number))
    believed, packet = random_times.timestamp(t, root_seed, seeds, taken), _first(_repeats(taken))
    numbers = _by_clock(len(each), -1, clock, packet, number)
    taken, believed = (jnp.where(packet == _rows(packet), a, NEVER) for a in (taken, believed))

    order = jnp.argsort(arrives, axis=0, stable=True)
    arrives, packet, clock = (jnp.take_along_axis(a, order, 0) for a in (arrives, packet, clock))
    again = _repeats(arrives)
    arrival = _first(again & _repeats(packet))
    mine = arrival == _rows(arrival)
    count = jnp.cumsum(mine, 0) - 1
    slot = count - jnp.take_along_axis(count, _first(again), 0)
    earlier = jnp.take_along_axis(arrives, jnp.maximum(_first(again) - 1, 0), 0)
    return EventTable(
        taken=taken,
        number=numbers,
        believed=believed,
        arrives=jnp.where(mine, arrives, NEVER),
        which=packet,
        brings=_by_clock(len(each), False, clock, arrival, True),
        slot=slot,
        ticks_since_arrival=arrives - jnp.where(_first(again) > 0, earlier, 0),
    )


def _rows(like: Array) -> Array:
    """The number of each row of a table [E, L]."""
    return jnp.broadcast_to(jnp.arange(len(like))[:, None], like.shape)


def _repeats(rows: Array) -> Array:
    """Whether each row [E, L] equals the one before."""
    return jnp.concatenate([jnp.zeros_like(rows[:1], bool), rows[1:] == rows[:-1]])


def _first(repeats: Array) -> Array:
    """The first row of the group of each row [E, L]; a group goes on where a row repeats the one before."""
    return lax.cummax(jnp.where(repeats, 0, _rows(repeats)), 0)


def _by_clock(clocks: int, fill: PyTree, clock: Array, row: Array, values: PyTree) -> Array:
    """A table [C, E, L] of values [E, L], each at its clock and row."""
    table = jnp.full((clocks, *row.shape), fill)
    return table.at[clock, row, jnp.arange(row.shape[1])].set(values)
