"""Measurements that overtake each other, put back in the order in which they were taken.

An observer here is a recursion over samples, state -> update(state, sample), and the network may deliver a sample after a
newer one. So the newest K samples are kept, with the state before them: one that comes late is put in its place, and
the recursion runs again from there. The estimate is then what it would have been, had the samples that have arrived come in
order. K is the most that can overtake one sample on this schedule; where none can, K = 0 and nothing is kept.
A sample older than all those kept is outside the room (`dynamics.linear`); on the schedule that K was made for there is
none.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Bool, Float, Int, PyTree

from pcbench.dynamics.room import within_room
from pcbench.observers.parts.common import known_input
from pcbench.protocols import Arrival, Leaf, Now, Room, vmap_as_unit


class Measurement(NamedTuple):
    """What arrived of one sampling instant; q outputs. In a buffer, with a leading axis [K]."""

    taken: Int[Array, "..."]  # tick at which the observer believes it was taken
    value: Float[Array, "... q"]  # with the plant's feedthrough D u removed
    mask: Bool[Array, "... q"]
    snapshot: Float[Array, "... noted"]
    variance_ratio: Float[Array, "... q"] | None = None  # as in `Arrival`

    def variances(self, R: Float[Leaf, " q"]) -> Float[Leaf, " q"]:
        """Return the variance of each value's noise, of a filter that takes R for it where the recording states none."""
        return R if self.variance_ratio is None else R * self.variance_ratio


class Buffer(NamedTuple):
    """The newest K samples by the tick they were taken, oldest first, and the state before them."""

    before: PyTree
    samples: Measurement  # [K]; a place not yet filled is not fresh


Update = Callable[[PyTree, Measurement], PyTree]  # (state, sample) -> state at the sample's tick


def start(state: PyTree, room: Room, outputs: int, noted: int) -> Buffer:
    """Return a buffer with nothing in it, with room for K samples."""
    K = room.shape[0]
    empty = Measurement(jnp.full(K, -1), jnp.zeros((K, outputs)), jnp.zeros((K, outputs), bool), jnp.zeros((K, noted)))
    return Buffer(state, empty)


def sample_of(now: Now, arrival: Arrival, D: Float[Leaf, "q m"]) -> Measurement:
    """Return what arrives as a sample; D u at the sample's tick is taken off its value."""
    age = jnp.max(jnp.where(arrival.mask, arrival.age, 0))  # channels that arrive together were sampled together
    value = arrival.value - known_input(D, now, arrival.age)
    return Measurement(now.tick - age, value, arrival.mask, arrival.snapshot, arrival.variance_ratio)


def kept_of(sample: Measurement) -> Measurement:
    """Return a sample as it is kept for later: 0 in place of what did not arrive."""
    return sample._replace(value=jnp.where(sample.mask, sample.value, 0.0))


def replay(update: Update, buffer: Buffer, arrived: Measurement) -> tuple[Buffer, PyTree]:
    """Return the buffer with the sample that arrived in its place, and the state after the newest sample."""
    if (oldest := getattr(buffer.before, "taken", None)) is not None:
        arrived = arrived._replace(taken=within_room(arrived.taken, arrived.taken >= oldest))
    if not buffer.samples.taken.shape[0]:
        state = update(buffer.before, arrived)
        return Buffer(state, buffer.samples), state
    entries, kept = _merge_sample(buffer.samples, arrived)
    newest, states = _through(update, buffer.before, entries)
    leaving = jax.tree.map(lambda a: lax.dynamic_index_in_dim(a, 0, keepdims=False), states)  # the oldest of K + 1
    return Buffer(leaving, kept), newest


def newest(update: Update, buffer: Buffer) -> PyTree:
    """Return the state after the newest sample that has arrived."""
    return _through(update, buffer.before, buffer.samples)[0] if buffer.samples.taken.shape[0] else buffer.before


def newest_with_copy(update: Update, copy: Update, buffer: Buffer, arrived: Measurement) -> PyTree:
    """Return the state after the newest sample, beside it a copy of the state at the tick at which one that arrives was taken.

    `copy` (state, sample) makes the copy, after the samples up to that tick and before those that are newer. So the copy is
    corrected by all that has arrived, and says what is expected of the sample: the innovations in the order of arrival are
    independent if the model is true.
    """
    entries, _ = _merge_sample(buffer.samples, arrived)
    place = jnp.sum(buffer.samples.taken <= arrived.taken)

    def step(state: PyTree, row: tuple[Array, Measurement]) -> tuple[PyTree, None]:
        i, sample = row
        used, copied = update(state, sample), copy(state, sample)
        there, here = jnp.any(sample.mask), i == place
        return jax.tree.map(lambda a, b, c: jnp.where(here, a, jnp.where(there, b, c)), copied, used, state), None

    return lax.scan(step, buffer.before, (jnp.arange(entries.taken.shape[0]), entries))[0]


def _through(update: Update, before: PyTree, entries: Measurement) -> tuple[PyTree, PyTree]:
    """The state after samples in order, and after each of them; an empty place leaves it as it is."""

    def step(state: PyTree, sample: Measurement) -> tuple[PyTree, PyTree]:
        there = jnp.any(sample.mask)
        new = jax.tree.map(lambda a, b: jnp.where(there, a, b), update(state, sample), state)
        return new, new

    return lax.scan(step, before, entries)


def _merge_sample(samples: Measurement, arrived: Measurement) -> tuple[Measurement, Measurement]:
    """K samples in the order they were taken, and one more in its place: [K + 1]; and the newest K of them.

    All runs merge in one piece: entry by entry, a program would grow with K.
    """

    def merge(samples: Measurement, arrived: Measurement) -> tuple[Measurement, Measurement]:
        later = samples.taken > arrived.taken
        stays, moves = jnp.append(~later, False), jnp.append(False, later)  # what is newer moves up by one

        def one(a: Array, b: Array) -> Array:
            s, m = (jnp.reshape(x, (-1, *[1] * b.ndim)) for x in (stays, moves))
            return jnp.where(s, jnp.concatenate([a, b[None]]), jnp.where(m, jnp.concatenate([b[None], a]), b[None]))

        merged = jax.tree.map(one, samples, arrived)
        return merged, jax.tree.map(lambda a: a[1:], merged)

    return vmap_as_unit(merge)(samples, arrived)
