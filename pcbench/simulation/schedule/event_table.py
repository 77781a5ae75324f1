"""The events of runs with random sampling, in order of time: packets taken and arrivals."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.simulation.schedule import random_times
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.random_times import ClockParams


class EventTable(NamedTuple):
    """Events of all runs: E rows, one per sample of each clock in sampling order; L runs, C clocks.

    Samples of one tick form one packet, in the row of the first of them. The parts of a packet that arrive at one tick form one
    arrival, in the row of the first of them. All other rows are at NEVER.
    """

    sampling_ticks: Array  # [E, L] tick of each packet
    number: Array  # [C, E, L] sample number of each clock in the packet; -1: none
    timestamp: Array  # [E, L] assumed sampling tick of a packet, possibly before 0
    arrives: Array  # [E, L] tick of the first, second ... arrival; NEVER: lost
    packet: Array  # [E, L] the row of the packet that arrives
    mask: Array  # [C, E, L] whether the arrival contains each clock's sample
    slot: Array  # [E, L] number of earlier arrivals at the same tick
    ticks_since_arrival: Array  # [E, L] ticks since the last tick at which anything arrived (from 0 before the first)


def event_table(t: ClockParams, root_seed: Array, seeds: Array) -> EventTable:
    """Return the events of every run in order of time; at one tick the older packet arrives first."""
    by_clock = [random_times.clock_times(t, c, root_seed, seeds) for c in range(t.due.shape[0])]
    sampling_ticks, arrives = (jnp.concatenate(part) for part in zip(*by_clock, strict=True))
    clock = jnp.concatenate([jnp.full_like(ticks, c) for c, (ticks, _) in enumerate(by_clock)])
    number = jnp.concatenate([jnp.broadcast_to(jnp.arange(len(ticks))[:, None], ticks.shape) for ticks, _ in by_clock])
    order = jnp.argsort(sampling_ticks, axis=0, stable=True)
    columns = sampling_ticks, arrives, clock, number
    sampling_ticks, arrives, clock, number = (jnp.take_along_axis(a, order, 0) for a in columns)
    timestamp = random_times.timestamp(t, root_seed, seeds, sampling_ticks)
    packet = _first(_repeats(sampling_ticks))
    numbers = _by_clock(len(by_clock), -1, clock, packet, number)
    is_packet = packet == _rows(packet)
    sampling_ticks, timestamp = (jnp.where(is_packet, a, NEVER) for a in (sampling_ticks, timestamp))

    order = jnp.argsort(arrives, axis=0, stable=True)
    arrives, packet, clock = (jnp.take_along_axis(a, order, 0) for a in (arrives, packet, clock))
    repeats = _repeats(arrives)
    arrival = _first(repeats & _repeats(packet))
    is_first = arrival == _rows(arrival)
    count = jnp.cumsum(is_first, 0) - 1
    slot = count - jnp.take_along_axis(count, _first(repeats), 0)
    previous = jnp.take_along_axis(arrives, jnp.maximum(_first(repeats) - 1, 0), 0)
    return EventTable(
        sampling_ticks=sampling_ticks,
        number=numbers,
        timestamp=timestamp,
        arrives=jnp.where(is_first, arrives, NEVER),
        packet=packet,
        mask=_by_clock(len(by_clock), False, clock, arrival, True),
        slot=slot,
        ticks_since_arrival=arrives - jnp.where(_first(repeats) > 0, previous, 0),
    )


def _rows(like: Array) -> Array:
    """Return the number of each row of a table [E, L]."""
    return jnp.broadcast_to(jnp.arange(len(like))[:, None], like.shape)


def _repeats(rows: Array) -> Array:
    """Return whether each row [E, L] equals the previous one."""
    return jnp.concatenate([jnp.zeros_like(rows[:1], bool), rows[1:] == rows[:-1]])


def _first(repeats: Array) -> Array:
    """Return the first row of each row's group [E, L]; a group continues where a row repeats the previous one."""
    return lax.cummax(jnp.where(repeats, 0, _rows(repeats)), 0)


def _by_clock(clocks: int, fill: PyTree, clock: Array, row: Array, values: PyTree) -> Array:
    """Return a table [C, E, L] with values [E, L], each at its clock and row."""
    table = jnp.full((clocks, *row.shape), fill)
    return table.at[clock, row, jnp.arange(row.shape[1])].set(values)
