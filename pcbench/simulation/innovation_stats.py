"""An observer that keeps, beside its memory, how far what arrived was from what it expected.

What it does is unchanged: `judged` puts its memory into one that has two sums more, and every jump adds to them first.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from pcbench.protocols import Arrival, Gains, Innovation, InnovationStats, Memory, Now, Observer
from pcbench.simulation.types import Layout


class Judged(NamedTuple):
    """An observer's memory, and the sums over all that has arrived."""

    memory: Memory
    so_far: InnovationStats


def watched(layout: Layout) -> Layout:
    """Return the layout with every observer judged that says what it expects of a sample."""
    every = ((label, judged(o, o.innovation) if o.innovation else o) for label, o in layout.observers)
    return layout._replace(observers=tuple(every))


def judged(o: Observer, innovation: Innovation) -> Observer:
    """Return an observer that does the same and sums what its innovations amount to."""

    def init(gains: Gains, xhat0: Array) -> Judged:
        return Judged(o.init(gains, xhat0), InnovationStats(jnp.zeros(()), jnp.zeros(())))

    def snapshot(gains: Gains, memory: Judged, now: Now) -> Array:
        return o.snapshot(gains, memory.memory, now)

    def jump(gains: Gains, memory: Judged, now: Now, arrival: Arrival) -> Judged:
        before, more = memory.so_far, innovation(gains, memory.memory, now, arrival)
        so_far = InnovationStats(before.nis_sum + more.nis_sum, before.dof + more.dof)
        return Judged(o.jump(gains, memory.memory, now, arrival), so_far)

    def flow(gains: Gains, memory: Judged, now: Now) -> Judged:
        return memory._replace(memory=o.flow(gains, memory.memory, now))

    def estimate(gains: Gains, memory: Judged) -> Array:
        return o.estimate(gains, memory.memory)

    made = Observer(init, snapshot, jump, flow, estimate)
    if (covariance := o.covariance) is not None:
        made = made._replace(covariance=lambda gains, memory, now: covariance(gains, memory.memory, now))
    if (on_sample := o.on_sample) is not None:
        made = made._replace(
            on_sample=lambda gains, memory, now, mask: memory._replace(
                memory=on_sample(gains, memory.memory, now, mask)
            )
        )
    if (init_random := o.init_random) is not None:
        made = made._replace(
            init_random=lambda gains, memory, words, xhat0: memory._replace(
                memory=init_random(gains, memory.memory, words, xhat0)
            )
        )
    return made


def sums(memory: Any) -> InnovationStats | None:
    """Return the sums of an observer that was judged."""
    return memory.so_far if isinstance(memory, Judged) else None
