"""Events on one schedule for all runs: at a tick every lane senses, or jumps, together.

Whole-number data (a `Schedule`) say where the events are; they are traced, so one compiled program serves every period
and delay. Packets in flight are kept in rings by packet number.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import draws, lanes
from pcbench.simulation.problem import Layout, Problem, State
from pcbench.simulation.steps import Row, begin, hand_over, measure, note


class Events(NamedTuple):
    """How events happen, and in what form the memories are kept between them."""

    happen: Callable[
        [Array, State], tuple[State, Array]
    ]  # (tick, state) -> state after the tick's events, next event's tick
    whole: Callable[[Any], Any] = lambda kept: kept  # as kept -> the observers' memories
    moved: Callable[[Any, Any], Any] = lambda memories, kept: memories  # memories after a flow, as kept -> as kept


def prepare(layout: Layout, p: Problem, root_seed: Array, seeds: Array) -> tuple[Events, State]:
    """Return the events of a block of runs, and the state before tick 0."""
    keys = draws.run_keys(root_seed, seeds, "measurement", p.noise_std.shape[0])
    state = rings(layout, p, keys, begin(layout, p, root_seed, seeds))
    return Events(lambda k, state: (happen(layout, p, keys, k, state), p.schedule.next_event[k])), state


def rings(layout: Layout, p: Problem, keys: list[Array], state: State) -> State:
    """Give the network its room, with the packets on it that were taken before tick 0: they have measured the start.

    A packet that nothing was noted for carries the note of the start (it is believed to be from before tick 0).
    """
    values, notes = jax.tree.map(lambda v: jnp.broadcast_to(v, (layout.ring + 1, *jnp.shape(v))), state.flight)

    def put(rings: Any, packet: tuple[Array, Array]) -> tuple[Any, None]:
        place, numbers = packet
        noise = lanes.split(draws.normals(keys, numbers))
        y = measure(layout, p, jnp.asarray(0), state.x, state.own, noise)
        y = lanes.like(y, state.flight[0], layout.width)
        return jax.tree.map(lambda ring, v: lax.dynamic_update_index_in_dim(ring, v, place, 0), rings, y), None

    if early := p.schedule.early.shape[0]:
        values, _ = lax.scan(put, values, (jnp.arange(early), p.schedule.early))
    return state._replace(flight=(values, notes))


def happen(layout: Layout, p: Problem, keys: list[Array], k: Array, state: State) -> State:
    """Let everything that the schedule has for tick k happen: sense and note, then deliver, the oldest packet first.

    Only one packet, never the ring of them, goes through a `cond`, which would copy it: what is not there is written to
    the ring's last place, which nothing reads.
    """
    plan = p.schedule

    def put(rings: Any, number: Array, make: Any) -> Any:
        last = jax.tree.map(lambda ring: ring[layout.ring], rings)
        new = lax.cond(number >= 0, lambda: lanes.like(make(), last, layout.width), lambda: last)
        place = jnp.where(number >= 0, number % layout.ring, layout.ring)
        return jax.tree.map(lambda ring, v: lax.dynamic_update_index_in_dim(ring, v, place, 0), rings, new)

    def sense() -> Any:
        return measure(layout, p, k, state.x, state.own, lanes.split(draws.normals(keys, plan.sample[k])))

    values = put(state.flight[0], plan.sense[k], sense)
    notes = put(state.flight[1], plan.note[k], lambda: note(layout, p, k, state.memories, state.commands))
    flight = (values, notes)

    def deliver(slot: Array, memories: Any) -> Any:
        number = plan.arrive[k, slot]
        packet = jax.tree.map(partial(lax.dynamic_index_in_dim, index=number % layout.ring, keepdims=False), flight)
        fresh, age = plan.fresh[k, slot], jnp.full(plan.fresh[k, slot].shape, k - plan.believed[k, slot])
        row = Row(fresh, age, plan.number[k, slot], plan.since[k, slot])

        def jump(memories: Any) -> Any:
            handed = hand_over(layout, p, k, row, packet, memories, state.commands, state.watches)
            return lanes.like(handed, memories, layout.width)

        return lax.cond(number >= 0, jump, lambda memories: memories, memories)

    memories = lax.fori_loop(0, plan.arrive.shape[1], deliver, state.memories)
    return state._replace(memories=memories, flight=flight)
