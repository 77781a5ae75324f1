"""One observer tick by tick on any samples, as the order of events has it, without the simulation: its functions alone.

A sample is the reference's (arrival, taken, channel, index, value). What is taken but never arrives has arrival None.
"""

from functools import partial
from typing import Any, NamedTuple

import hurried
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from pcbench.observers import OBSERVERS
from pcbench.protocols import Arrival, Now

SLOTS = 4  # arrivals of different instants at one tick


class Traffic(NamedTuple):
    """What is taken and what arrives at every tick; q channels."""

    taken: Any  # [N+1, q]
    when: Any  # [N+1, S] the tick of a sample that arrives, -1: none
    mask: Any  # [N+1, S, q]
    value: Any  # [N+1, S, q]


def traffic(times, samples, ticks, q):
    """`times`: (taken, arrival) by channel; the samples are those that arrive."""
    found = Traffic(np.zeros((ticks + 1, q), bool), np.full((ticks + 1, SLOTS), -1),
                    np.zeros((ticks + 1, SLOTS, q), bool), np.zeros((ticks + 1, SLOTS, q)))  # fmt: skip
    for j, channel in enumerate(times):
        for taken, _ in channel:
            found.taken[taken, j] = True
    for s in sorted(samples, key=lambda s: (s.arrival, s.taken)):
        row = found.when[s.arrival]
        slot = row.tolist().index(s.taken if s.taken in row else -1)
        row[slot] = s.taken
        found.mask[s.arrival, slot, s.channel], found.value[s.arrival, slot, s.channel] = True, s.value
    return found


@partial(jax.jit, static_argnums=0, compiler_options=hurried.options())
def _run(name, gains, traffic, u, h, xhat0):
    o = OBSERVERS[name].observer
    q = traffic.taken.shape[1]

    def now(k, decided):
        def past_u(age):
            return jnp.where(k >= age, u[jnp.maximum(k - age, 0)], 0.0)

        return Now(k * h, k, h, past_u(jnp.asarray(0 if decided else 1)), past_u)

    def tick(carry, row):
        memory, notes = carry
        k, t = row
        notes = notes.at[k].set(o.snapshot(gains, memory, now(k, False)))
        if o.on_sample:
            told = lambda m: o.on_sample(gains, m, now(k, False), t.taken)  # noqa: E731
            memory = lax.cond(t.taken.any(), told, lambda m: m, memory)

        def deliver(carry, slot):
            memory, so_far = carry
            when, mask, value = slot
            arrival = Arrival(value, mask, jnp.full(q, k - when), jnp.zeros(q, int), notes[when], jnp.asarray(0))
            jump = lambda m: o.jump(gains, m, now(k, False), arrival)  # noqa: E731
            if o.innovation:
                found = jnp.stack(o.innovation(gains, memory, now(k, False), arrival)[:2])
                so_far = so_far + jnp.where(when >= 0, found, 0.0)
            return (lax.cond(when >= 0, jump, lambda m: m, memory), so_far), None

        (memory, surprise), _ = lax.scan(deliver, (memory, jnp.zeros(2)), (t.when, t.mask, t.value))
        seen = o.estimate(gains, memory), o.covariance(gains, memory, now(k, False)), surprise
        return (o.flow(gains, memory, now(k, True)), notes), seen

    memory = o.init(gains, xhat0)
    notes = jnp.zeros((len(u), len(o.snapshot(gains, memory, now(jnp.asarray(0), True)))))
    return lax.scan(tick, (memory, notes), (jnp.arange(len(u)), traffic))[1]


def run(name, context, options, traffic, u, xhat0):
    """Return xhat [N+1, n] and what the observer believes of its error [N+1, n, n]."""
    return whole(name, context, options, traffic, u, xhat0)[:2]


def whole(name, context, options, traffic, u, xhat0):
    """Return the same, and of what arrives at each tick nu' S^-1 nu and how many numbers it is of, [N+1, 2]."""
    gains = OBSERVERS[name].design(context, OBSERVERS[name].options(**options)).gains
    given = jax.tree.map(jnp.asarray, (gains, traffic, u, context.dt, xhat0))
    return tuple(map(np.asarray, _run(name, *given)))
