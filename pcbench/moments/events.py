"""Samples and arrivals of many grid points: the protocol functions at an event, and their effect on mean and covariance.

Grid points have events at different ticks. At a tick with an event of any grid point, all are processed; the others do not
change. If samples are lost independently, second moments over losses follow a recursion. With mean m and covariance P, and
J z + b the effect of an arrival of probability c on z,

    m+ = m + c (J m + b - m),   P+ = c (J P J' + G G') + (1 - c) P + c (1 - c) d d',   d = J m + b - m

(jump-linear systems: Costa, Fragoso, Marques, Discrete-Time Markov Jump Linear Systems, 2005).

A sample's noise is added when the sample arrives, as it has no effect before. So packets in flight need no room for it, and no
room at all if the plant has no noise.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, PyTree

from pcbench.moments.inputs import Event, Mix, MomentInputs, Numbers
from pcbench.moments.noise_state import (
    Form,
    OneCell,
    congruence,
    jacobian,
    map_over_cells,
    outer_square,
    product,
    vector,
    vectors,
)
from pcbench.protocols import Arrival
from pcbench.simulation import simulate_runs
from pcbench.simulation.simulate_runs import Run, select
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout, present


class BatchState(NamedTuple):
    """The propagated state of C grid points; D numbers that noise reaches, first those of the state, then those of packets."""

    runs: Run  # [1 + P, ..., C] the run without noise, then runs with noise
    flight: Float[Array, "1+P rows f C"]  # packets in flight by number: measurement and snapshots
    P: Float[Array, "D D C"]  # covariance without the effect of the initial state
    # linear prediction of runs with noise, minus the run without; then effects of the initial state
    shifts: Float[Array, "P+s D C"]
    mode_difference: Array  # [C] for modes: largest difference between merged modes in values that noise does not reach


class Shape(NamedTuple):
    """The static part of a program in addition to the layout."""

    cells: int
    form: Form
    per_cell: tuple[bool, ...]  # which arrays of the problem are separate for each grid point
    record: str = ""  # nothing, "std" or "covariance" over time
    interval: int = 1  # recording interval in ticks
    entrywise: bool = False  # whether functions of a state are written entry by entry


class Batch(NamedTuple):
    """A batch of grid points, and the function that maps functions of one over all of them."""

    layout: Layout
    shape: Shape
    inputs: MomentInputs
    map_cells: Callable[[OneCell], Callable[..., PyTree]]  # noise_state.map_over_cells
    std: Array  # [q, C] of a sample


def make_batch(layout: Layout, shape: Shape, inputs: MomentInputs) -> Batch:
    """Return a batch."""
    p, std = inputs.problem, jnp.asarray(inputs.problem.noise_std)
    return Batch(
        layout=layout._replace(width=1, watch=False),
        shape=shape,
        inputs=inputs,
        map_cells=map_over_cells(p, shape.per_cell, shape.cells, shape.entrywise),
        std=jnp.broadcast_to(std if std.ndim == 2 else std[:, None], (len(std), shape.cells)),
    )


def sense(layout: Layout, p: GridPointParams, k: Array, run: Run, noise: PyTree, inputs: PyTree) -> Array:
    """Return the noise-free measurement and the snapshots of all observers: [f]."""
    y = layout.plant.output(p.params, present(p, k, True), run.x)
    snapshots = simulate_runs.take_snapshots(layout, p, k, run.memories, run.commands)
    return jnp.concatenate([y, *(snapshots[label] for label, _ in layout.observers)])


def notify(layout: Layout, p: GridPointParams, k: Array, run: Run, noise: Array, mask: Array) -> Run:
    """Return the run after observers are notified which channels [q] are sampled now, if any."""
    return _update_memories(jnp.any(mask), simulate_runs.notify(layout, p, k, run, mask), run)


def jump(
    layout: Layout, p: GridPointParams, k: Array, run: Run, packet: Array, inputs: tuple[Array, ArrivalInfo]
) -> Run:
    """Return the run after a packet [f], if one arrives: `inputs` is (whether, ArrivalInfo)."""
    arrives, info = inputs
    shapes = jax.eval_shape(lambda run: simulate_runs.take_snapshots(layout, p, k, run.memories, run.commands), run)
    snapshots, at = {}, p.noise_std.shape[0]
    for label, _ in layout.observers:
        snapshots[label] = packet[at : at + shapes[label].shape[0]]
        at += shapes[label].shape[0]
    arrival = partial(
        Arrival,
        packet[: p.noise_std.shape[0]],
        info.mask,
        info.age,
        info.number,
        ticks_since_arrival=info.ticks_since_arrival,
    )
    return _update_memories(arrives, simulate_runs.jump(layout, p, k, run, snapshots, arrival), run)


def _update_memories(mask: Array, memories: PyTree, run: Run) -> Run:
    """Return the run with new memories where `mask` is true, with unchanged types."""
    new = jax.tree.map(lambda a, b: a.astype(b.dtype), select(mask, memories, run.memories), run.memories)
    return run._replace(memories=new)


def apply_events(batch: Batch, k: Array, event: Event, state: BatchState, noise: Array) -> BatchState:
    """Apply all events of tick k: merge modes, sample, take snapshots and notify, then deliver, the oldest first.

    `noise` [P, S, q] is that of the runs with noise, by arrival.
    """
    q = batch.std.shape[0]
    if mix := batch.inputs.mix:
        state = lax.cond(jnp.any(mix.merges[k]), lambda: _merge_modes(batch.shape.form, mix, k, state), lambda: state)
    number = jnp.stack([event.sense] * q + [event.snapshot] * (state.flight.shape[2] - q))
    rows = jnp.arange(state.flight.shape[1])[:, None, None]
    mask = rows == _place(number, state)[None]
    for packet in event.extra_snapshots:
        is_snapshot = rows == _place(packet, state)[None, None]
        mask = mask | (is_snapshot & (jnp.arange(state.flight.shape[2]) >= q)[None, :, None])
    state = take_samples(batch, k, state, mask)
    if any(o.on_sample for _, o in batch.layout.observers):
        state = _notify(batch, k, event.sampled_channels, state)

    def deliver(slot: Array, state: BatchState) -> BatchState:
        info = ArrivalInfo(event.mask, k - event.timestamp, event.number, event.ticks_since_arrival)
        number, info = jax.tree.map(lambda a: a[slot], (event.arrive, info))
        info = info._replace(age=jnp.broadcast_to(info.age[None], info.mask.shape))
        return _deliver(batch, k, number, info, state, noise[:, slot])

    slots = len(event.arrive)
    return deliver(jnp.asarray(0), state) if slots == 1 else lax.fori_loop(0, slots, deliver, state)


def take_samples(batch: Batch, k: Array, state: BatchState, mask: Array) -> BatchState:
    """Store measurements and snapshots of this tick in the places [rows, f, C] where `mask` is true."""
    no_noise = jnp.zeros((0, batch.std.shape[1]))
    new = jax.vmap(lambda run: batch.map_cells(partial(sense, batch.layout))(k, run, no_noise, ()))(state.runs)
    flight = jnp.where(mask[None], new[:, None], state.flight)
    if not batch.shape.form.flight:
        return state._replace(flight=flight)
    matrix = batch.map_cells(jacobian(batch.shape.form, partial(sense, batch.layout), lambda y: y))
    M = matrix(k, _mean(state), no_noise, ())
    A, shape = M.shape[1], mask.shape[:2]

    def rows(P: Array) -> Array:
        packets = P[A:].reshape(*shape, *P.shape[1:])
        new_packets = jnp.where(mask[:, :, None], product(M, P[:A])[None], packets)
        return jnp.concatenate([P[:A], new_packets.reshape(P[A:].shape)])

    return state._replace(flight=flight, P=congruence(rows, state.P), shifts=_map_vectors(rows, state.shifts))


def _notify(batch: Batch, k: Array, mask: Numbers, state: BatchState) -> BatchState:
    """Notify the observers of each grid point of its samples, [q, C]."""
    no_noise = jnp.zeros((0, batch.std.shape[1]))
    form = batch.shape.form
    M = batch.map_cells(jacobian(form, partial(notify, batch.layout), partial(vector, form)))(
        k, _mean(state), no_noise, mask
    )
    runs = jax.vmap(lambda run: batch.map_cells(partial(notify, batch.layout))(k, run, no_noise, mask))(state.runs)

    def rows(P: Array) -> Array:
        return jnp.concatenate([product(M, P[: len(M)]), P[len(M) :]])

    return state._replace(runs=runs, P=congruence(rows, state.P), shifts=_map_vectors(rows, state.shifts))


def _deliver(batch: Batch, k: Array, number: Array, info: ArrivalInfo, state: BatchState, noise: Array) -> BatchState:
    """Deliver one packet of each grid point."""
    q, form, inputs, chance = batch.std.shape[0], batch.shape.form, (number >= 0, info), batch.inputs.chance
    place = _place(number, state)
    mask = (jnp.arange(state.flight.shape[1])[:, None] == place[None])[:, None]
    packets = jnp.take_along_axis(state.flight, place[None, None, None], 1)[:, 0]
    f = partial(jump, batch.layout)
    M = batch.map_cells(jacobian(form, f, partial(vector, form)))(k, _mean(state), packets[0], inputs)
    A, v = M.shape[0], noise[:, :, None] * batch.std[None]
    packets = packets.at[1:, :q].add(v)
    new_runs = jax.vmap(lambda run, packet: batch.map_cells(f)(k, run, packet, inputs))(state.runs, packets)
    runs = jax.tree.map(partial(_mix_by_chance, chance), new_runs, state.runs)
    step = vectors(form, new_runs) - vectors(form, state.runs)
    G = M[:, A : A + q] * batch.std[None]

    def rows(P: Array) -> Array:
        state_rows = product(M[:, :A], P[:A])
        if form.flight:
            packets = P[A:].reshape(*state.flight.shape[1:3], *P.shape[1:])
            state_rows = state_rows + product(M[:, A:], jnp.sum(jnp.where(mask[:, :, None], packets, 0.0), 0))
        return jnp.concatenate([state_rows, P[A:]])

    new_shifts = _map_vectors(rows, state.shifts)
    spread = outer_square(jnp.moveaxis(jnp.concatenate([step[:1], (new_shifts - state.shifts)[len(v) :, :A]]), 0, 1))
    noise_shift = jnp.sum(M[None, :, A : A + q] * v[:, None], 2) * chance[None, None]
    noise_covariance = chance[None, None] * (outer_square(G) + (1 - chance)[None, None] * spread)
    P = _mix_by_chance(chance, congruence(rows, state.P), state.P).at[:A, :A].add(noise_covariance)
    shifts = _mix_by_chance(chance, new_shifts, state.shifts).at[: len(v), :A].add(noise_shift)
    return state._replace(runs=runs, P=P, shifts=shifts)


def _mix_by_chance(chance: Numbers, new: Array, old: Array) -> Array:
    """Return the mean of `new` with probability `chance` and `old` otherwise; exactly `new` if the probability is 1."""
    if not jnp.issubdtype(old.dtype, jnp.floating):
        return new
    chance = chance.reshape(*(1 for _ in old.shape[1:]), -1)
    return jnp.where(chance == 1, new, old + chance * (new - old))


def _place(number: Array, state: BatchState) -> Array:
    """Return the ring row of a packet; without a packet the last row, which nothing reads."""
    rows = state.flight.shape[1] - 1
    return jnp.where(number >= 0, number % rows, rows)


def _map_vectors(rows: Callable[[Array], Array], vectors: Array) -> Array:
    """Apply a linear map of rows to vectors [P, D, C]."""
    return jax.vmap(lambda d: rows(d[:, None])[:, 0])(vectors)


def _mean(state: BatchState) -> Run:
    return jax.tree.map(lambda a: a[0], state.runs)


def _merge_modes(form: Form, mix: Mix, k: Array, state: BatchState) -> BatchState:
    """Return the state after modes merge at tick k (see `delay_modes`): conditional means and covariances, mixed."""
    mask, n_noisy = mix.merges[k], state.flight.shape[0] - 1  # runs with noise

    def on(v: Array, a: Array) -> Array:  # numbers [C], one per mode, broadcast to [..., C]
        return v.reshape(*(1 for _ in a.shape[1:]), -1)

    def mean(a: Array) -> Array:
        pairs = zip(mix.source, mix.weight, strict=True)
        return jnp.where(on(mask, a), sum(on(weight, a) * a[..., source] for source, weight in pairs), a)

    z = vectors(form, state.runs)[0]
    if form.flight:
        z = jnp.concatenate([z, state.flight[0].reshape(-1, z.shape[-1])])
    z = jnp.concatenate([z[None], state.shifts[n_noisy:]])
    mixed_mean, P = mean(z), jnp.zeros_like(state.P)
    for source, weight in zip(mix.source, mix.weight, strict=True):
        difference = jnp.moveaxis(z[..., source] - mixed_mean, 0, 1)
        P = P + on(weight, P) * (state.P[..., source] + outer_square(difference))
    leaves, tree = jax.tree.flatten(state.runs)
    unlike_modes, runs = jnp.zeros_like(state.mode_difference), []
    for a, is_noisy in zip(leaves, form.noisy, strict=True):
        runs.append(mean(a) if is_noisy else jnp.where(on(mask, a), a[..., mix.source[0]], a))
        unlike_modes = unlike_modes if is_noisy else jnp.maximum(unlike_modes, mode_differences(mix, a))
    return state._replace(
        runs=jax.tree.unflatten(tree, runs),
        flight=mean(state.flight),
        P=jnp.where(on(mask, P), P, state.P),
        shifts=mean(state.shifts),
        mode_difference=jnp.maximum(state.mode_difference, jnp.where(mask, unlike_modes, 0.0)),
    )


def mode_differences(mix: Mix, a: Array) -> Array:
    """Return the largest relative difference [C] between merged modes, in noise-free numbers [..., C]."""
    first, out = a[..., mix.source[0]], jnp.zeros(a.shape[-1])
    for source in mix.source[1:]:
        values = a[..., source]
        difference = jnp.abs(values.astype(float) - first.astype(float))
        difference = jnp.where(values == first, 0.0, jnp.where(jnp.isnan(difference), jnp.inf, difference))
        difference, size = (
            jnp.max(x, tuple(range(a.ndim - 1)), initial=0.0) for x in (difference, jnp.abs(first.astype(float)))
        )
        out = jnp.maximum(out, difference / jnp.maximum(size, 1e-300))
    return out
