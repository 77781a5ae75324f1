"""An observer run against data that can be changed: one lane, tick by tick, in the order of a run's events.

What the network brings may be shifted, packet by packet (value and note), and so may the ages and the inputs: what an estimate
depends on is then seen by comparing two replays bit for bit.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.protocols import Arrival, Leaf, Observer, Plant
from pcbench.simulation.problem import Problem, present


class Shift(NamedTuple):
    """What is added to the data. P packets are N + 1, one a tick at most."""

    value: Leaf  # [P + 1, q]
    note: Leaf  # [P + 1]


class Replay(NamedTuple):
    """Every tick 0 .. N."""

    x: Array  # [N+1, n]
    xhat: Array  # [N+1, n or n + s] after the jump of each tick


def none(p: Problem) -> Shift:
    """Return the shift that changes nothing."""
    many = p.schedule.sense.shape[0] + 1
    return Shift(jnp.zeros((many, p.noise_std.shape[0])), jnp.zeros(many))


@partial(jax.jit, static_argnums=(0, 1))
def replay(plant: Plant, observer: Observer, p: Problem, gains: Any, shift: Shift) -> Replay:
    """Run one lane over the whole schedule: sense and note, deliver, estimate, flow."""
    p = jax.tree.map(jnp.asarray, p)
    plan, spare = p.schedule, shift.note.shape[0] - 1  # what is not there is written to the spare place

    def put(table: Array, number: Array, row: Array) -> Array:
        return table.at[jnp.where(number >= 0, number, spare)].set(row)

    def delivered(k: Array, slot: Array, memory: Any, values: Array, notes: Array) -> Any:
        number = plan.arrive[k, slot]
        fresh, age = plan.fresh[k, slot], jnp.full(plan.fresh.shape[2], k - plan.believed[k, slot])
        arrival = Arrival(values[number], fresh, age, plan.number[k, slot], notes[number], plan.since[k, slot])
        now = present(p, k, False)
        return lax.cond(number >= 0, lambda m: observer.jump(gains, m, now, arrival), lambda m: m, memory)

    def tick(carry: Any, k: Array) -> tuple[Any, Replay]:
        x, memory, values, notes = carry
        now, before = present(p, k, True), present(p, k, False)
        y = plant.output(p.params, now, x)
        values = put(values, plan.sense[k], y + shift.value[plan.sense[k]])
        note = jnp.asarray(observer.note(gains, memory, before))
        notes = put(notes, plan.note[k], note + shift.note[plan.note[k]].astype(note.dtype))
        slots = plan.arrive.shape[1]
        memory = lax.fori_loop(0, slots, lambda slot, m: delivered(k, slot, m, values, notes), memory)
        row = Replay(x, jnp.asarray(observer.estimate(gains, memory)))
        return (plant.step(p.params, now, x), observer.flow(gains, memory, now), values, notes), row

    memory = jax.tree.map(jnp.asarray, observer.init(gains, p.xhat0))
    note = jax.eval_shape(lambda m: jnp.asarray(observer.note(gains, m, present(p, jnp.asarray(0), False))), memory)
    start = p.x0, memory, jnp.zeros(shift.value.shape), jnp.zeros((spare + 1, *note.shape), note.dtype)
    _, out = lax.scan(tick, start, jnp.arange(plan.sense.shape[0]))
    return out
