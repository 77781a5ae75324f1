"""Buffer that puts out-of-sequence measurements back into the order in which they were taken.

An observer here is a recursion over samples, state -> update(state, sample). The network may deliver a sample after a newer
one. So the buffer stores the newest K samples and the state before them. An out-of-sequence sample is inserted, and the
recursion runs again from that state. The estimate is then that for arrival in the order of sampling.
K is the largest number of newer samples that may arrive before a sample on this schedule. If K = 0, no samples are stored. A
sample older than all stored ones is outside the room (`dynamics.room`), which cannot happen on the schedule for which K was
computed.
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
    """A measurement that has arrived, with all q outputs of one sampling time; in a buffer, with a leading axis [K]."""

    tick: Int[Array, "..."]  # sampling tick according to the timestamp
    value: Float[Array, "... q"]  # with the plant's feedthrough D u removed
    mask: Bool[Array, "... q"]
    snapshot: Float[Array, "... snapshot"]
    variance_ratio: Float[Array, "... q"] | None = None  # as in `Arrival`

    def variances(self, R: Float[Leaf, " q"]) -> Float[Leaf, " q"]:
        """Return the noise variance of each value: R, scaled by the variance that a recording states."""
        return R if self.variance_ratio is None else R * self.variance_ratio


class Buffer(NamedTuple):
    """The newest K samples in the order of sampling, oldest first, and the state before them."""

    before: PyTree
    samples: Measurement  # [K]; `mask` is False in an empty place


Update = Callable[[PyTree, Measurement], PyTree]  # (state, sample) -> state at the sample's tick


def start(state: PyTree, room: Room, outputs: int, snapshot_size: int) -> Buffer:
    """Return an empty buffer with room for K samples."""
    K = room.shape[0]
    empty = Measurement(
        jnp.full(K, -1), jnp.zeros((K, outputs)), jnp.zeros((K, outputs), bool), jnp.zeros((K, snapshot_size))
    )
    return Buffer(state, empty)


def sample_of(now: Now, arrival: Arrival, D: Float[Leaf, "q m"]) -> Measurement:
    """Return an arrival as a sample, with D u at the sampling tick subtracted from its values."""
    age = jnp.max(jnp.where(arrival.mask, arrival.age, 0))  # channels that arrive together were sampled together
    value = arrival.value - known_input(D, now, arrival.age)
    return Measurement(now.tick - age, value, arrival.mask, arrival.snapshot, arrival.variance_ratio)


def zero_missing(sample: Measurement) -> Measurement:
    """Return a sample for the buffer, with 0 for channels that did not arrive."""
    return sample._replace(value=jnp.where(sample.mask, sample.value, 0.0))


def replay(update: Update, buffer: Buffer, measurement: Measurement) -> tuple[Buffer, PyTree]:
    """Return the buffer with the arriving sample inserted, and the state after the newest sample."""
    if (oldest := getattr(buffer.before, "tick", None)) is not None:
        measurement = measurement._replace(tick=within_room(measurement.tick, measurement.tick >= oldest))
    if not buffer.samples.tick.shape[0]:
        state = update(buffer.before, measurement)
        return Buffer(state, buffer.samples), state
    entries, newest_samples = _merge_sample(buffer.samples, measurement)
    newest_state, states = _run_recursion(update, buffer.before, entries)
    before = jax.tree.map(lambda a: lax.dynamic_index_in_dim(a, 0, keepdims=False), states)  # the oldest of K + 1
    return Buffer(before, newest_samples), newest_state


def newest(update: Update, buffer: Buffer) -> PyTree:
    """Return the state after the newest sample that has arrived."""
    return _run_recursion(update, buffer.before, buffer.samples)[0] if buffer.samples.tick.shape[0] else buffer.before


def newest_with_copy(update: Update, copy: Update, buffer: Buffer, measurement: Measurement) -> PyTree:
    """Return the state after the newest sample, extended by a copy of the state at the sampling tick of an arriving sample.

    `copy` (state, sample) makes the copy, after the samples up to that tick and before newer ones. All samples that have
    arrived correct the copy, so it predicts the arriving sample. If the model is true, the innovations in the order of
    arrival are independent.
    """
    entries, _ = _merge_sample(buffer.samples, measurement)
    copy_index = jnp.sum(buffer.samples.tick <= measurement.tick)

    def step(state: PyTree, row: tuple[Array, Measurement]) -> tuple[PyTree, None]:
        i, sample = row
        posterior, with_copy = update(state, sample), copy(state, sample)
        has_sample, is_copy = jnp.any(sample.mask), i == copy_index
        return jax.tree.map(
            lambda a, b, c: jnp.where(is_copy, a, jnp.where(has_sample, b, c)), with_copy, posterior, state
        ), None

    return lax.scan(step, buffer.before, (jnp.arange(entries.tick.shape[0]), entries))[0]


def _run_recursion(update: Update, before: PyTree, entries: Measurement) -> tuple[PyTree, PyTree]:
    """Return the state after samples in order, and the states after each of them; an empty place does not change the state."""

    def step(state: PyTree, sample: Measurement) -> tuple[PyTree, PyTree]:
        has_sample = jnp.any(sample.mask)
        after = jax.tree.map(lambda a, b: jnp.where(has_sample, a, b), update(state, sample), state)
        return after, after

    return lax.scan(step, before, entries)


def _merge_sample(samples: Measurement, measurement: Measurement) -> tuple[Measurement, Measurement]:
    """Return K samples and a new one in the order of sampling, [K + 1], and the newest K of them.

    All runs merge as a unit, because a program that does so entry by entry would grow with K.
    """

    def merge(samples: Measurement, measurement: Measurement) -> tuple[Measurement, Measurement]:
        is_newer = samples.tick > measurement.tick
        is_before, is_after = jnp.append(~is_newer, False), jnp.append(False, is_newer)  # what is newer moves up by one

        def merge_leaf(a: Array, b: Array) -> Array:
            s, m = (jnp.reshape(x, (-1, *[1] * b.ndim)) for x in (is_before, is_after))
            return jnp.where(s, jnp.concatenate([a, b[None]]), jnp.where(m, jnp.concatenate([b[None], a]), b[None]))

        entries = jax.tree.map(merge_leaf, samples, measurement)
        return entries, jax.tree.map(lambda a: a[1:], entries)

    return vmap_as_unit(merge)(samples, measurement)
