"""Measurements that overtake each other, put back in the order in which they were taken.

An observer here is a recursion over samples, state -> update(state, sample), and the network may deliver a sample after a
newer one. So the state before the newest K samples is kept with those K samples: one that comes late is put in its place,
and the recursion runs again from there. The estimate is then what it would have been, had the samples that have arrived come in
order. K is the most that can overtake one sample on this schedule; where none can, K = 0 and nothing is kept.
Not claimed: that a sample older than all that is kept is used; on the schedule K was made for there is none.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pcbench.types import Arrival, Leaf, Now


class Sample(NamedTuple):
    """What arrived of one sampling instant; q outputs, r numbers noted."""

    taken: Array  # tick at which the observer believes it was taken
    value: Array  # [q] with the plant's feedthrough D u removed
    fresh: Array  # [q] bool
    note: Array  # [r]


class Line(NamedTuple):
    """The newest K samples by the tick they were taken, oldest first, and the state before them."""

    before: Any
    samples: Sample  # each entry with a leading axis [K]; a place not yet filled is not fresh


Update = Callable[[Any, Sample], Any]  # (state, sample) -> state at the sample's tick


def start(state: Any, places: Leaf, outputs: int, noted: int) -> Line:
    """Return a line with nothing in it, room for len(`places`) samples."""
    K = places.shape[0]
    empty = Sample(jnp.full(K, -1), jnp.zeros((K, outputs)), jnp.zeros((K, outputs), bool), jnp.zeros((K, noted)))
    return Line(state, empty)


def sample_of(now: Now, arrival: Arrival, D: Leaf) -> Sample:
    """Return what arrives as a sample; D[q, m] u at the sample's tick is taken off its value."""
    known = jnp.stack([D[j] @ now.past_u(arrival.age[j]) for j in range(D.shape[0])])
    age = jnp.max(jnp.where(arrival.fresh, arrival.age, 0))  # the channels that come together were taken together
    return Sample(now.tick - age, arrival.value - known, arrival.fresh, arrival.note)


def replay(update: Update, line: Line, arrived: Sample) -> tuple[Line, Any]:
    """Return the line with the sample that arrived in its place, and the state after the newest sample."""
    K, entries = (
        line.samples.taken.shape[0],
        [jax.tree.map(lambda a, i=i: a[i], line.samples) for i in range(_size(line))],
    )
    moving = arrived
    for i in reversed(range(K)):  # from the newest down: what is newer than the arrival stays to its right
        later = entries[i].taken > moving.taken
        newer = jax.tree.map(lambda a, b, later=later: jnp.where(later, a, b), entries[i], moving)
        moving = jax.tree.map(lambda a, b, later=later: jnp.where(later, b, a), entries[i], moving)
        entries[i] = newer
    before = _one(update, line.before, moving)  # the oldest of K + 1 leaves the line
    state = before
    for entry in entries:
        state = _one(update, state, entry)
    kept = jax.tree.map(lambda *a: jnp.stack(a), *entries) if K else line.samples
    return Line(before, kept), state


def _size(line: Line) -> int:
    return int(line.samples.taken.shape[0])


def _one(update: Update, state: Any, sample: Sample) -> Any:
    """Update with a sample; with an empty place leave the state as it is."""
    new = update(state, sample)
    return jax.tree.map(lambda a, b: jnp.where(jnp.any(sample.fresh), a, b), new, state)
