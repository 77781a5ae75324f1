"""A batch of cells from tick 0 to its end: the compiled program of exact moments.

The loop is that of `simulation.loop`: at an event samples are taken and packets arrive, then plant and observers flow to the
next. What goes along is the run without noise, a run with noise (`affine`), and the covariance of all that noise reaches. A
tick's matrix is taken anew only where one product with it differs from the last tick's: between events it hardly ever does.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.moments import last_tick
from pcbench.moments import sums as sums_of
from pcbench.moments.covariance import product, squared, turned
from pcbench.moments.events import Means, Moving, happen, sense, taken
from pcbench.moments.given import SCALES, Given
from pcbench.moments.start import begin
from pcbench.moments.sums import Read, Seen
from pcbench.moments.ticks import Tick, flat, flown, matrix_of, one_cell
from pcbench.moments.vector import Form, over_cells, slope, steady, vector
from pcbench.simulation.problem import Layout, State

COVARIANCE = "covariance"


class Shape(NamedTuple):
    """What is compiled in besides the layout."""

    cells: int
    form: Form
    own: tuple[bool, ...]  # which arrays of the problem are each cell's own
    recorded: str = ""  # nothing, "std" or COVARIANCE at every tick
    written: bool = False  # whether functions of a state are written out entry by entry


class Recorded(NamedTuple):
    """Moments at every tick 0 .. N; Z signals of all observers, one after another."""

    mean: Array  # [N+1, Z, C]
    covariance: Array  # [N+1, Z, Z, C], or of each signal [N+1, Z, 1, C]


class Found(NamedTuple):
    """What a batch leaves."""

    sums: sums_of.Sums
    rows: Any  # Recorded; (): nothing is recorded
    last: Any = ()  # Last, of a layout with consistency
    unlike: Any = ()  # [C] of modes, as in `events.Moving`


class Carried(NamedTuple):
    """From tick to tick."""

    moving: Moving
    tick: Tick
    sums: sums_of.Sums
    rows: Any
    last: Any = ()


def run(layout: Layout, shape: Shape, given: Given) -> Found:
    """Return the moments of a batch of cells over ticks 0 .. N - 1, or recorded, 0 .. N."""
    layout, p = layout._replace(width=1, watch=False), given.problem
    end = p.windows[-1, 1]
    stop = end + 1 if shape.recorded else end
    std = jnp.broadcast_to(
        p.noise_std if p.noise_std.ndim == 2 else p.noise_std[:, None], (len(p.noise_std), shape.cells)
    )
    by = Means(
        layout=layout,
        form=shape.form,
        over=over_cells(p, shape.own, shape.cells, shape.written),
        plan=given.plan,
        std=std,
        chance=given.chance,
        mix=given.mix,
    )

    def events(k: Array, m: Moving) -> Moving:
        return happen(by, k, m, given.arrivals[k])

    def segment(at: tuple[Array, Carried]) -> tuple[Array, Carried]:
        k, c = at
        c = c._replace(moving=events(k, c.moving))
        following = jnp.minimum(jnp.min(given.plan.next_event[k]), stop)
        return following, lax.fori_loop(k, following, partial(_tick, by, shape, given), c)

    _, carried = lax.while_loop(lambda at: at[0] < stop, segment, (jnp.asarray(0), _begin(by, shape, given)))
    return Found(carried.sums, carried.rows, carried.last, carried.moving.unlike)


def _tick(by: Means, shape: Shape, given: Given, k: Array, c: Carried) -> Carried:
    """Estimate, control and flow: one tick of all cells, and what is kept of it."""
    m, p, layout = c.moving, given.problem, by.layout
    late, w = (), given.ticks[k]
    late = tuple(each[k // p.network.every] for each in given.network) if layout.pending else ()
    none = jnp.zeros((w.shape[1], shape.cells))
    mean = jax.tree.map(lambda a: a[0], m.runs)
    entering = jnp.concatenate([none[None], jnp.broadcast_to(w[:, :, None], (len(w), *none.shape))])
    runs, seen, tick = flown(by, k, m.runs, entering, late, c.tick)
    joint = shape.recorded == COVARIANCE or layout.consistency
    m, read = _moved(joint, m._replace(runs=runs), tick.matrix, seen, w)
    tail, end = p.windows[0, 1], p.windows[-1, 1]
    weight = jnp.stack([k < end, (k < end) & (k >= tail)]) * 1.0
    return Carried(
        m,
        tick,
        sums_of.added(c.sums, read, weight, p.weights),
        _record(c.rows, k, read) if shape.recorded else (),
        last_tick.kept(by, k, k == end - 1, mean, read, c.last) if layout.consistency else (),
    )


def _moved(joint: bool, m: Moving, M: Array, seen: Seen, w: Array) -> tuple[Moving, Read]:
    """Move covariances by a tick's matrix, and read those of what is seen: `joint`, or in an open loop the variances alone."""
    A, D = M.shape[1] - w.shape[1], m.P.shape[0]
    S, N = M[:, :A], M[:, A:]
    X = product(S, m.P[:A])  # [A + V, D, C]
    Z = seen.errors.shape[1]
    if M.shape[0] - A == Z and not joint:
        covariance = (jnp.sum(X[A:, :A] * S[A:], 1) + jnp.sum(N[A:] ** 2, 1))[:, None]
    else:
        covariance = product(X[A:, :A], turned(S[A:])) + squared(N[A:])
    P = product(X[:A, :A], turned(S[:A])) + squared(N[:A])
    if D > A:
        P = m.P.at[:A, :A].set(P).at[:A, A:].set(X[:A, A:]).at[A:, :A].set(turned(X[:A, A:]))
    moved = jax.vmap(lambda d: product(S, d[:A, None])[:, 0])(m.apart)
    moved = moved + jnp.sum(N[None] * w[:, None, :, None], 2)
    apart = m.apart.at[:, :A].set(moved[:, :A])
    return m._replace(P=P, apart=apart), Read(seen, covariance, moved[:, A:])


def _begin(by: Means, shape: Shape, given: Given) -> Carried:
    """Everything before tick 0; packets taken before it have measured the start."""
    cells, zero, p, form, layout = shape.cells, jnp.asarray(0), given.problem, by.form, by.layout
    n, q, many = p.x0.shape[0], by.std.shape[0], len(SCALES)
    drawn = jnp.broadcast_to(given.start[:, :, None], (many, 2 * n, cells))
    start = partial(begin, layout)
    entering = jnp.concatenate([jnp.zeros_like(drawn[:1]), drawn])
    runs = jax.vmap(lambda e: by.over(start)(zero, (), e, ()))(entering)

    def made(p: Any, k: Array, state: Any, e: Array, rest: Any) -> Array:
        return jax.jacfwd(lambda e: vector(form, start(p, k, (), e, ())))(e)

    B = by.over(made)(zero, (), entering[0], ())
    mean = jax.tree.map(lambda a: a[0], runs)
    first = by.over(partial(sense, layout))(zero, mean, jnp.zeros((0, cells)), ())
    rows, f, A = layout.ring + 1, first.shape[0], B.shape[0]
    D = A + rows * f * form.flight
    flight = jnp.zeros((1 + many, rows, f, cells))
    apart = jnp.zeros((many, D, cells)).at[:, :A].set(jnp.sum(B[None] * drawn[:, None], 2))
    unlike = jnp.zeros(cells) if by.mix else ()
    m = Moving(runs, flight, jnp.zeros((D, D, cells)).at[:A, :A].set(squared(B)), apart, unlike)
    m = taken(by, zero, m, jnp.broadcast_to((jnp.arange(f) >= q)[None, :, None], (rows - 1, f, cells)))
    for place in range(given.plan.early.shape[0]):
        there = jnp.any(given.plan.early[place] >= 0, 0)
        here = (jnp.arange(rows - 1)[:, None] == place) & (jnp.arange(f) < q)[None]
        m = taken(by, zero, m, here[:, :, None] & there[None, None])
    late = tuple(each[0] for each in given.network) if layout.pending else ()
    shown, seen = _shapes(by, given, runs, late)
    none = jnp.zeros((given.ticks.shape[2], cells))
    if steady(p, shape.own, slope(form, partial(one_cell, layout), partial(flat, form)), mean, none, late):
        tick = Tick(matrix_of(by)(zero, mean, none, late), ())
    else:
        tick = Tick(jnp.zeros((A + shown, A + len(none), cells)), jnp.full((A + shown, cells), jnp.nan))
    targets = seen.off.shape[0] if layout.controller else None
    sums, recorded = sums_of.nothing(len(seen.errors), targets, cells), _rows(shape, len(seen.errors), given)
    return Carried(m, tick, sums, recorded, last_tick.nothing(by, mean, len(seen.errors)) if layout.consistency else ())


def _shapes(by: Means, given: Given, runs: State, late: Any) -> tuple[int, Seen]:
    """How many numbers are read at a tick, and their shapes."""
    none = jnp.zeros((given.ticks.shape[2], by.std.shape[1]))
    mean = jax.tree.map(lambda a: a[0], runs)
    _, seen = jax.eval_shape(lambda s: by.over(partial(one_cell, by.layout))(jnp.asarray(0), s, none, late), mean)
    return sum(len(each) for each in seen), seen


def _rows(shape: Shape, signals: int, given: Given) -> Any:
    """Room for the moments of every tick, where they are recorded."""
    if not shape.recorded:
        return ()
    ticks, cells = given.plan.sense.shape
    others = signals if shape.recorded == COVARIANCE else 1
    return Recorded(jnp.zeros((ticks, signals, cells)), jnp.zeros((ticks, signals, others, cells)))


def _record(rows: Recorded, k: Array, read: Read) -> Recorded:
    """Write down the moments of tick k."""
    mean = read.runs.errors[0]
    Z, wide = len(mean), rows.covariance.shape[2] > 1
    covariance = read.covariance[:Z, :Z] if wide else sums_of.variances(read)[:Z, None]
    write = lax.dynamic_update_index_in_dim
    return Recorded(write(rows.mean, mean, k, 0), write(rows.covariance, covariance, k, 0))
