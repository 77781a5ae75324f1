"""Buffer that puts out-of-sequence measurements back into the order in which they were taken.

An observer here is a recursion over samples, state -> update(state, sample). The network may deliver a sample after a newer
one. So the buffer stores the newest K samples and the state before them. An out-of-sequence sample is inserted, and the
recursion runs again from that state. The estimate is then that for arrival in the order of sampling.
K is the largest number of newer samples that may arrive before a sample on this schedule. If K = 0, no samples are stored. A
sample older than all stored ones is outside the room (`dynamics.room`), which cannot happen on the schedule for which K was
computed. If all runs have the same schedule, the state after the newest sample is stored too: a sample in order then costs two
steps of the recursion instead of K + 1.
"""

from collections.abc import Callable
from functools import partial
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
    """The newest K samples in the order of sampling, oldest first, and the states before and after them."""

    before: PyTree
    samples: Measurement  # [K]; `mask` is False in an empty place
    after: PyTree = None  # None: not stored


Update = Callable[[PyTree, Measurement], PyTree]  # (state, sample) -> state at the sample's tick


def start(state: PyTree, room: Room, outputs: int, snapshot_size: int) -> Buffer:
    """Return an empty buffer with room [K] for K samples, or [K, 1] for the state after them too."""
    K = room.shape[0]
    empty = Measurement(
        jnp.full(K, -1), jnp.zeros((K, outputs)), jnp.zeros((K, outputs), bool), jnp.zeros((K, snapshot_size))
    )
    return Buffer(state, empty, state if K and room.ndim > 1 else None)


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
    entries, samples = _merge_sample(buffer.samples, measurement)
    step = partial(_step, update)

    def repeat() -> tuple[PyTree, PyTree]:
        """Use all samples again, from the state before them."""
        newest_state, states = lax.scan(lambda state, sample: 2 * (step(state, sample),), buffer.before, entries)
        return jax.tree.map(lambda a: lax.dynamic_index_in_dim(a, 0, keepdims=False), states), newest_state

    def append() -> tuple[PyTree, PyTree]:
        """Move the state before the samples by the oldest sample, and the state after them by the newest."""
        states = jax.tree.map(lambda *a: jnp.stack(a), buffer.before, buffer.after)
        pair = jax.tree.map(lambda a: jnp.stack([a[0], a[-1]]), entries)
        _, states = lax.scan(lambda _, row: ((), step(*row)), (), (states, pair))
        return jax.tree.map(lambda a: a[0], states), jax.tree.map(lambda a: a[1], states)

    if buffer.after is None:
        before, newest_state = repeat()
        return Buffer(before, samples), newest_state
    before, newest_state = lax.cond(_is_newest(buffer, measurement), append, repeat)
    return Buffer(before, samples, newest_state), newest_state


def newest(update: Update, buffer: Buffer) -> PyTree:
    """Return the state after the newest sample that has arrived."""
    if not buffer.samples.tick.shape[0]:
        return buffer.before
    if buffer.after is not None:
        return buffer.after
    return lax.scan(lambda state, sample: (_step(update, state, sample), None), buffer.before, buffer.samples)[0]


def replace_states(buffer: Buffer, function: Callable[[PyTree], PyTree]) -> Buffer:
    """Return the buffer with the function's results for its states."""
    after = None if buffer.after is None else function(buffer.after)
    return Buffer(function(buffer.before), buffer.samples, after)


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
        return _where(i == copy_index, copy(state, sample), _step(update, state, sample)), None

    def repeat() -> PyTree:
        return lax.scan(step, buffer.before, (jnp.arange(entries.tick.shape[0]), entries))[0]

    if buffer.after is None:
        return repeat()
    return lax.cond(_is_newest(buffer, measurement), lambda: copy(buffer.after, measurement), repeat)


def _is_newest(buffer: Buffer, measurement: Measurement) -> Bool[Array, ""]:
    """Return whether no sample that has arrived is newer than an arriving one."""
    return jnp.all(buffer.samples.tick <= measurement.tick)


def _step(update: Update, state: PyTree, sample: Measurement) -> PyTree:
    """Return the state after a sample; an empty place does not change it."""
    return _where(jnp.any(sample.mask), update(state, sample), state)


def _where(condition: Bool[Array, ""], a: PyTree, b: PyTree) -> PyTree:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


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
