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
from pcbench.moments.noise_state import Form, OneCell, both, outer_square, over_cells, product, slope, vector, vectors
from pcbench.protocols import Arrival
from pcbench.simulation import simulate_runs
from pcbench.simulation.simulate_runs import Run, select
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout, present


class Moving(NamedTuple):
    """The propagated state of C grid points; D numbers that noise reaches, first those of the state, then those of packets."""

    runs: Run  # [1 + P, ..., C] the run without noise, then runs with noise
    flight: Float[Array, "1+P rows f C"]  # packets in flight by number: measurement and snapshots
    P: Float[Array, "D D C"]  # covariance without the effect of the initial state
    apart: Float[
        Array, "P+s D C"
    ]  # linear prediction of runs with noise, minus the run without; then effects of the initial state
    unlike: Array  # [C] for modes: largest difference between merged modes in values that noise does not reach


class Shape(NamedTuple):
    """The static part of a program in addition to the layout."""

    cells: int
    form: Form
    own: tuple[bool, ...]  # which arrays of the problem are separate for each grid point
    recorded: str = ""  # nothing, "std" or "covariance" over time
    every: int = 1  # recording interval in ticks
    written: bool = False  # whether functions of a state are written entry by entry


class Batch(NamedTuple):
    """A batch of grid points, and the function that maps functions of one over all of them."""

    layout: Layout
    shape: Shape
    given: MomentInputs
    over: Callable[[OneCell], Callable[..., PyTree]]  # noise_state.over_cells
    std: Array  # [q, C] of a sample


def batch(layout: Layout, shape: Shape, given: MomentInputs) -> Batch:
    """Return a batch."""
    p, std = given.problem, jnp.asarray(given.problem.noise_std)
    return Batch(
        layout=layout._replace(width=1, watch=False),
        shape=shape,
        given=given,
        over=over_cells(p, shape.own, shape.cells, shape.written),
        std=jnp.broadcast_to(std if std.ndim == 2 else std[:, None], (len(std), shape.cells)),
    )


def sense(layout: Layout, p: GridPointParams, k: Array, run: Run, nothing: PyTree, rest: PyTree) -> Array:
    """Return the noise-free measurement and the snapshots of all observers: [f]."""
    y = layout.plant.output(p.params, present(p, k, True), run.x)
    notes = simulate_runs.take_notes(layout, p, k, run.memories, run.commands)
    return jnp.concatenate([y, *(notes[label] for label, _ in layout.observers)])


def notify(layout: Layout, p: GridPointParams, k: Array, run: Run, nothing: Array, mask: Array) -> Run:
    """Return the run after observers are notified which channels [q] are sampled now, if any."""
    return _update_memories(jnp.any(mask), simulate_runs.notify(layout, p, k, run, mask), run)


def jump(layout: Layout, p: GridPointParams, k: Array, run: Run, packet: Array, rest: tuple[Array, ArrivalInfo]) -> Run:
    """Return the run after a packet [f], if one arrives: `rest` is (whether, ArrivalInfo)."""
    there, row = rest
    found = jax.eval_shape(lambda run: simulate_runs.take_notes(layout, p, k, run.memories, run.commands), run)
    notes, at = {}, p.noise_std.shape[0]
    for label, _ in layout.observers:
        notes[label] = packet[at : at + found[label].shape[0]]
        at += found[label].shape[0]
    arrival = partial(
        Arrival,
        packet[: p.noise_std.shape[0]],
        row.mask,
        row.age,
        row.number,
        ticks_since_arrival=row.ticks_since_arrival,
    )
    return _update_memories(there, simulate_runs.jump(layout, p, k, run, notes, arrival), run)


def _update_memories(there: Array, memories: PyTree, run: Run) -> Run:
    """Return the run with new memories if `there`, with unchanged types."""
    new = jax.tree.map(lambda a, b: a.astype(b.dtype), select(there, memories, run.memories), run.memories)
    return run._replace(memories=new)


def happen(by: Batch, k: Array, now: Event, m: Moving, noise: Array) -> Moving:
    """Apply all events of tick k: merge modes, sample, take snapshots and notify, then deliver, the oldest first.

    `noise` [P, S, q] is that of the runs with noise, by arrival.
    """
    q = by.std.shape[0]
    if mix := by.given.mix:
        m = lax.cond(jnp.any(mix.here[k]), lambda: _merge_modes(by.shape.form, mix, k, m), lambda: m)
    number = jnp.stack([now.sense] * q + [now.snapshot] * (m.flight.shape[2] - q))
    rows = jnp.arange(m.flight.shape[1])[:, None, None]
    here = rows == _place(number, m)[None]
    for more in now.extra_snapshots:
        noted = rows == _place(more, m)[None, None]
        here = here | (noted & (jnp.arange(m.flight.shape[2]) >= q)[None, :, None])
    m = take_samples(by, k, m, here)
    m = _notify(by, k, now.sampled, m) if any(o.on_sample for _, o in by.layout.observers) else m

    def deliver(slot: Array, m: Moving) -> Moving:
        row = ArrivalInfo(now.mask, k - now.timestamp, now.number, now.ticks_since_arrival)
        number, row = jax.tree.map(lambda a: a[slot], (now.arrive, row))
        return _deliver(
            by, k, number, row._replace(age=jnp.broadcast_to(row.age[None], row.mask.shape)), m, noise[:, slot]
        )

    slots = len(now.arrive)
    return deliver(jnp.asarray(0), m) if slots == 1 else lax.fori_loop(0, slots, deliver, m)


def take_samples(by: Batch, k: Array, m: Moving, here: Array) -> Moving:
    """Store measurements and snapshots of this tick in the places [rows, f, C] where `here`."""
    nothing = jnp.zeros((0, by.std.shape[1]))
    new = jax.vmap(lambda run: by.over(partial(sense, by.layout))(k, run, nothing, ()))(m.runs)
    flight = jnp.where(here[None], new[:, None], m.flight)
    if not by.shape.form.flight:
        return m._replace(flight=flight)
    M = by.over(slope(by.shape.form, partial(sense, by.layout), lambda y: y))(k, _mean(m), nothing, ())
    A, shape = M.shape[1], here.shape[:2]

    def rows(P: Array) -> Array:
        packets = P[A:].reshape(*shape, *P.shape[1:])
        put = jnp.where(here[:, :, None], product(M, P[:A])[None], packets)
        return jnp.concatenate([P[:A], put.reshape(P[A:].shape)])

    return m._replace(flight=flight, P=both(rows, m.P), apart=_each(rows, m.apart))


def _notify(by: Batch, k: Array, mask: Numbers, m: Moving) -> Moving:
    """Notify the observers of each grid point of its samples, [q, C]."""
    nothing = jnp.zeros((0, by.std.shape[1]))
    M = by.over(slope(by.shape.form, partial(notify, by.layout), partial(vector, by.shape.form)))(
        k, _mean(m), nothing, mask
    )
    runs = jax.vmap(lambda run: by.over(partial(notify, by.layout))(k, run, nothing, mask))(m.runs)

    def rows(P: Array) -> Array:
        return jnp.concatenate([product(M, P[: len(M)]), P[len(M) :]])

    return m._replace(runs=runs, P=both(rows, m.P), apart=_each(rows, m.apart))


def _deliver(by: Batch, k: Array, number: Array, row: ArrivalInfo, m: Moving, noise: Array) -> Moving:
    """Deliver one packet of each grid point."""
    q, form, rest = by.std.shape[0], by.shape.form, (number >= 0, row)
    place = _place(number, m)
    here = (jnp.arange(m.flight.shape[1])[:, None] == place[None])[:, None]
    packets = jnp.take_along_axis(m.flight, place[None, None, None], 1)[:, 0]
    M = by.over(slope(form, partial(jump, by.layout), partial(vector, form)))(k, _mean(m), packets[0], rest)
    A, scaled = M.shape[0], noise[:, :, None] * by.std[None]
    packets = packets.at[1:, :q].add(scaled)
    jumped = jax.vmap(lambda run, packet: by.over(partial(jump, by.layout))(k, run, packet, rest))(m.runs, packets)
    runs = jax.tree.map(partial(_mix_by_chance, by.given.chance), jumped, m.runs)
    step = vectors(form, jumped) - vectors(form, m.runs)
    G = M[:, A : A + q] * by.std[None]

    def rows(P: Array) -> Array:
        found = product(M[:, :A], P[:A])
        if form.flight:
            packets = P[A:].reshape(*m.flight.shape[1:3], *P.shape[1:])
            found = found + product(M[:, A:], jnp.sum(jnp.where(here[:, :, None], packets, 0.0), 0))
        return jnp.concatenate([found, P[A:]])

    after = _each(rows, m.apart)
    spread = outer_square(jnp.moveaxis(jnp.concatenate([step[:1], (after - m.apart)[len(scaled) :, :A]]), 0, 1))
    pushed = jnp.sum(M[None, :, A : A + q] * scaled[:, None], 2) * by.given.chance[None, None]
    added = by.given.chance[None, None] * (outer_square(G) + (1 - by.given.chance)[None, None] * spread)
    P = _mix_by_chance(by.given.chance, both(rows, m.P), m.P).at[:A, :A].add(added)
    return m._replace(
        runs=runs, P=P, apart=_mix_by_chance(by.given.chance, after, m.apart).at[: len(scaled), :A].add(pushed)
    )


def _mix_by_chance(chance: Numbers, after: Array, before: Array) -> Array:
    """Return the mean of `after` with probability `chance` and `before` otherwise; exactly `after` if the probability is 1."""
    if not jnp.issubdtype(before.dtype, jnp.floating):
        return after
    chance = chance.reshape(*(1 for _ in before.shape[1:]), -1)
    return jnp.where(chance == 1, after, before + chance * (after - before))


def _place(number: Array, m: Moving) -> Array:
    """Return the ring row of a packet; without a packet the last row, which nothing reads."""
    rows = m.flight.shape[1] - 1
    return jnp.where(number >= 0, number % rows, rows)


def _each(rows: Callable[[Array], Array], apart: Array) -> Array:
    """Apply a linear map of rows to vectors [P, D, C]."""
    return jax.vmap(lambda d: rows(d[:, None])[:, 0])(apart)


def _mean(m: Moving) -> Run:
    return jax.tree.map(lambda a: a[0], m.runs)


def _merge_modes(form: Form, mix: Mix, k: Array, m: Moving) -> Moving:
    """Return the state after modes merge at tick k (see `delay_modes`): conditional means and covariances, mixed."""
    here, noisy = mix.here[k], m.flight.shape[0] - 1  # with noise

    def on(v: Array, a: Array) -> Array:  # numbers [C], one per mode, broadcast to [..., C]
        return v.reshape(*(1 for _ in a.shape[1:]), -1)

    def mean(a: Array) -> Array:
        pairs = zip(mix.source, mix.weight, strict=True)
        return jnp.where(on(here, a), sum(on(weight, a) * a[..., source] for source, weight in pairs), a)

    z = vectors(form, m.runs)[0]
    if form.flight:
        z = jnp.concatenate([z, m.flight[0].reshape(-1, z.shape[-1])])
    z = jnp.concatenate([z[None], m.apart[noisy:]])
    middle, P = mean(z), jnp.zeros_like(m.P)
    for source, weight in zip(mix.source, mix.weight, strict=True):
        apart = jnp.moveaxis(z[..., source] - middle, 0, 1)
        P = P + on(weight, P) * (m.P[..., source] + outer_square(apart))
    leaves, tree = jax.tree.flatten(m.runs)
    unlike, runs = jnp.zeros_like(m.unlike), []
    for a, moves in zip(leaves, form.moving, strict=True):
        runs.append(mean(a) if moves else jnp.where(on(here, a), a[..., mix.source[0]], a))
        unlike = unlike if moves else jnp.maximum(unlike, modes_apart(mix, a))
    return m._replace(
        runs=jax.tree.unflatten(tree, runs),
        flight=mean(m.flight),
        P=jnp.where(on(here, P), P, m.P),
        apart=mean(m.apart),
        unlike=jnp.maximum(m.unlike, jnp.where(here, unlike, 0.0)),
    )


def modes_apart(mix: Mix, a: Array) -> Array:
    """Return the largest relative difference [C] between merged modes, in noise-free numbers [..., C]."""
    first, out = a[..., mix.source[0]], jnp.zeros(a.shape[-1])
    for source in mix.source[1:]:
        other = a[..., source]
        off = jnp.abs(other.astype(float) - first.astype(float))
        off = jnp.where(other == first, 0.0, jnp.where(jnp.isnan(off), jnp.inf, off))
        off, size = (jnp.max(x, tuple(range(a.ndim - 1)), initial=0.0) for x in (off, jnp.abs(first.astype(float))))
        out = jnp.maximum(out, off / jnp.maximum(size, 1e-300))
    return out
