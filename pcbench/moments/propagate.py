"""The ticks from one event to the next, some at a time, and what is kept of them.

Runs go tick by tick. Covariances go by powers of a tick's matrix, over all ticks at once, while that matrix stays what it is;
where that is not known beforehand, one at a time.

Some ticks in a row without an event: powers of a tick's matrix move covariances over all of them at once.

With z what noise reaches, s what is seen of it at a tick and w the noise of a tick, the matrix of a tick is that of
(z, w) -> (z+, s). Where it is the same at every tick, z after j ticks is F_j z and noise of covariance Q_j, and what is seen
then is E_j z and noise of covariance R_j.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from pcbench.moments import error_sums as sums_of
from pcbench.moments import final_tick, mean_runs
from pcbench.moments.error_sums import Read, Seen
from pcbench.moments.events import Means
from pcbench.moments.inputs import Given
from pcbench.moments.nees import WRITTEN_OUT, product, squared, turned
from pcbench.moments.tick_matrix import Tick, flown, matrix_of, one_cell
from pcbench.moments.types import COVARIANCE, Carried, Recorded, Shape


class Powers(NamedTuple):
    """What a tick's matrix makes of J ticks in a row."""

    moved: Float[Array, "J A A C"]  # F_1 .. F_J
    pushed: Float[Array, "J A A C"]  # Q_1 .. Q_J
    seen: Float[Array, "J V A C"]  # E_0 .. E_(J-1)
    noise: Float[Array, "J V X C"]  # R_0 .. R_(J-1): X is V where it is to be joint, 1 where variances alone are


def powers(matrix: Array, A: int, ticks: int, joint: bool) -> Powers:
    """Return what a tick's matrix [A + V, A + w, C] makes of 1 to so many ticks."""
    S, N = matrix[:, :A], matrix[:, A:]
    direct = squared(N[A:]) if joint else jnp.sum(N[A:] ** 2, 1)[:, None]
    one = Powers(S[:A], squared(N[:A]), S[A:], direct)

    def following(F: Array, Q: Array) -> Powers:
        seen = product(S[A:], Q)
        noise = product(seen, turned(S[A:])) if joint else jnp.sum(seen * S[A:], 1)[:, None]
        moved, pushed = product(one.moved, F), product(product(one.moved, Q), turned(one.moved)) + one.pushed
        return Powers(moved, pushed, product(S[A:], F), noise + direct)

    def another(last: Powers, _: None) -> tuple[Powers, Powers]:
        new = following(last.moved, last.pushed)
        return new, new

    first = jax.tree.map(lambda a: a[None], one)
    if ticks == 1:
        return first
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), first, lax.scan(another, one, None, ticks - 1)[1])


def covariances(by: Powers, P: Float[Array, "D D C"], joint: bool) -> Array:
    """Return those of what is seen at ticks 0 .. J - 1: `joint` [J, V, V, C], or variances alone [J, V, 1, C]."""
    J, V, A, cells = by.seen.shape
    E, P = by.seen, P[:A, :A]
    if not joint and A <= WRITTEN_OUT:
        return sum((_row(E, P[None, None, None], a) for a in range(A)), by.noise)
    X = product(E.reshape(J * V, A, cells), P).reshape(E.shape)
    return (jax.vmap(lambda x, e: product(x, turned(e)))(X, E) if joint else jnp.sum(X * E, 2)[:, :, None]) + by.noise


def _row(E: Array, P: Array, a: int) -> Array:
    """What a covariance's row up to the diagonal adds to variances [J, V, 1, C]: those beyond it are the same again."""
    before = (2 * P[..., a, b, :] * E[:, :, b, None] for b in range(a))
    return E[:, :, a, None] * sum(before, P[..., a, a, :] * E[:, :, a, None])


def after(by: Powers, ticks: Array, P: Float[Array, "D D C"]) -> Float[Array, "D D C"]:
    """Return the covariance after 1 to J ticks; what is on the network, beyond the first A numbers, stays as it is."""
    F, Q = by.moved[ticks - 1], by.pushed[ticks - 1]
    A = len(F)
    X = product(F, P[:A])
    moved = product(X[:, :A], turned(F)) + Q
    if len(P) == A:
        return moved
    return P.at[:A, :A].set(moved).at[:A, A:].set(X[:, A:]).at[A:, :A].set(turned(X[:, A:]))


def seen_of(by: Powers, z: Float[Array, "P D C"]) -> Float[Array, "J P V C"]:
    """Return what is seen of vectors at ticks 0 .. J - 1."""
    J, V, A, cells = by.seen.shape
    each = jax.vmap(lambda d: product(by.seen.reshape(J * V, A, cells), d[:A, None])[:, 0])(z)
    return jnp.moveaxis(each.reshape(len(z), J, V, cells), 1, 0)


def later(by: Powers, ticks: Array, z: Float[Array, "P D C"]) -> Float[Array, "P D C"]:
    """Return vectors after 1 to J ticks."""
    F = by.moved[ticks - 1]
    A = len(F)
    return z.at[:, :A].set(jax.vmap(lambda d: product(F, d[:A, None])[:, 0])(z))


TICKS = 4  # at a time, between events that are as many apart: a cell of the cart takes two thirds; of 8 and 16 no less


class Shown(NamedTuple):
    """What J ticks show."""

    seen: Any  # Seen [J, 1 + P, ..., C], or as entries
    moved: Any  # [J, P + s, V, C] where linear maps put what is `apart` (events.Moving); (): powers say it


class Ways(NamedTuple):
    """How a batch goes from event to event."""

    by: Means
    shape: Shape
    given: Given
    many: int  # ticks that go together
    room: Shown  # of so many ticks, none of them there yet
    joint: bool  # whether covariances between what is seen are asked for
    known: Powers | None  # of the matrix of every tick; None: it is looked at tick by tick
    changes: Array | None = None  # [N+1] at which later tick it changes next; None: at none
    parted: Any = ()  # the problem for entries of states side by side; (): states go as arrays

    @property
    def sparse(self) -> bool:
        """Whether at most one of the ticks that go together is recorded."""
        return self.shape.every >= self.many


def ways(by: Means, shape: Shape, given: Given, tick: Tick, seen: Seen, changes: Array | None, vectors: int) -> Ways:
    """Return how a batch goes; `seen` has the shapes of what one run shows at a tick, `vectors` go by linear maps."""
    joint = shape.recorded == COVARIANCE or by.layout.consistency or any(len(each) for each in seen[1:])
    steady = isinstance(tick.shown, tuple)
    sparse = len(given.plan.at) * TICKS <= len(given.arrivals)  # events, by the room that there is for them
    many = TICKS if steady and sparse and not by.layout.consistency else 1
    cells, size = shape.cells, sum(len(each) for each in seen)
    both, entry_by_entry = 1 + given.ticks.shape[1], shape.written and many > 1
    alone = jax.tree.map(lambda a: jnp.zeros((many, both, *a.shape)), seen)
    room = mean_runs.room(seen, many, both) if entry_by_entry else alone
    parted = mean_runs.of_problem(given.problem, shape.own, both) if entry_by_entry else ()
    known = powers(tick.matrix, _reached(given, tick), many, joint) if steady else None
    moved = () if steady and not given.ticks.shape[2] else jnp.zeros((many, vectors, size, cells))
    return Ways(
        by=by,
        shape=shape,
        given=given,
        many=many,
        room=Shown(room, moved),
        joint=joint,
        known=known,
        changes=changes,
        parted=parted,
    )


def _reached(given: Given, tick: Tick) -> int:
    """How many numbers of a state noise reaches."""
    return tick.matrix.shape[1] - given.ticks.shape[2]


def along(go: Ways, start: Array, stop: Array, c: Carried) -> Carried:
    """Go from an event to the next; where a tick's matrix changes on the way, from change to change."""
    changes = go.changes
    if changes is None:
        return _along(go, start, stop, c)

    def piece(at: tuple[Array, Carried]) -> tuple[Array, Carried]:
        k, c = at
        new = (k > 0) & (changes[k - 1] == k)
        mean, none = jax.tree.map(lambda a: a[0], c.moving.runs), jnp.zeros((go.given.ticks.shape[2], go.shape.cells))
        matrix = lax.cond(new, lambda: matrix_of(go.by)(k, mean, none, ()), lambda: c.tick.matrix)
        known = powers(matrix, _reached(go.given, c.tick), go.many, go.joint)
        until = jnp.minimum(changes[k], stop)
        return until, _along(go._replace(known=known), k, until, c._replace(tick=Tick(matrix, ())))

    return lax.while_loop(lambda at: at[0] < stop, piece, (start, c))[1]


def _along(go: Ways, start: Array, stop: Array, c: Carried) -> Carried:
    """Go so far that a tick's matrix stays what it is, or look at it at every tick."""
    many, both = go.many, 1 + go.given.ticks.shape[1]

    def some(at: tuple[Array, Carried]) -> tuple[Array, Carried]:
        until = jnp.minimum(at[0] + many, stop)
        return until, _some(go, at[0], until, at[1])

    def carried(c: Carried, change: Callable[[Any], Any]) -> Carried:
        return c._replace(moving=c.moving._replace(runs=change(c.moving.runs))) if go.parted else c

    begun = carried(c, lambda runs: jax.tree.map(mean_runs.entries, runs))
    _, ended = lax.while_loop(lambda at: at[0] < stop, some, (start, begun))
    return carried(ended, lambda runs: mean_runs.arrays(runs, both, go.shape.cells))


def _some(go: Ways, k: Array, until: Array, c: Carried) -> Carried:
    """Estimate, control and flow: up to J ticks of all cells, and what is kept of them."""
    m, by, p = c.moving, go.by, go.given.problem
    start, both = (m.runs, m.apart, c.tick, go.room), 1 + go.given.ticks.shape[1]
    runs, apart, tick, shown = lax.fori_loop(k, until, lambda i, at: _tick(go, i, i - k, at), start)
    known = powers(tick.matrix, _reached(go.given, tick), 1, go.joint) if go.known is None else go.known
    seen = mean_runs.of_ticks(shown.seen, both, go.shape.cells) if go.parted else shown.seen
    moved = shown.moved
    if isinstance(moved, tuple):
        moved, apart = seen_of(known, apart), later(known, until - k, apart)
    covariance = covariances(known, m.P, go.joint) + _second(moved[:, both - 1 :], go.joint)
    read = Read(seen, covariance, moved[:, : both - 1])
    at, (tail, end) = k + jnp.arange(go.many), (p.windows[0, 1], p.windows[-1, 1])
    counts = (at < until) & (at < end)
    return Carried(
        m._replace(runs=runs, apart=apart, P=after(known, until - k, m.P)),
        tick,
        sums_of.added(c.sums, read, jnp.stack([counts, counts & (at >= tail)]), p.weights, at),
        _record(go, c.rows, k, until, read) if go.shape.recorded else (),
        final_tick.kept(by, k, k == end - 1, jax.tree.map(lambda a: a[0], m.runs), read, c.last)
        if by.layout.consistency
        else (),
    )


def _tick(go: Ways, k: Array, place: Array, at: Any) -> Any:
    """One tick of all runs, and where linear maps put those with noise."""
    runs, apart, tick, shown = at
    w, network = go.given.ticks[k], go.given.network
    late = tuple(each[k // go.given.problem.network.every] for each in network) if go.by.layout.pending else ()
    none = jnp.zeros((1, w.shape[1], go.shape.cells))
    entering = jnp.concatenate([none, jnp.broadcast_to(w[:, :, None], (len(w), *none.shape[1:]))])
    if go.parted:
        one = mean_runs.over(partial(one_cell, go.by.layout), go.parted, len(entering) * go.shape.cells)
        runs, seen = one(k, runs, mean_runs.entries(entering), late)
    else:
        runs, seen, tick = flown(go.by, k, runs, entering, late, tick)
    shown = shown._replace(seen=jax.tree.map(partial(_put, place), shown.seen, seen))
    if isinstance(shown.moved, tuple):
        return runs, apart, tick, shown
    A = _reached(go.given, tick)
    moved = jax.vmap(lambda d: product(tick.matrix[:, :A], d[:A, None])[:, 0])(apart)
    moved = moved.at[: len(w)].add(jnp.sum(tick.matrix[None, :, A:] * w[:, None, :, None], 2))
    return runs, apart.at[:, :A].set(moved[:, :A]), tick, shown._replace(moved=_put(place, shown.moved, moved[:, A:]))


def _second(start: Array, joint: bool) -> Array:
    """What the start [J, s, V, C] adds to covariances [J, V, V, C], or to variances [J, V, 1, C]."""
    if not joint:
        return jnp.sum(start * start, 1)[:, :, None]
    return jax.vmap(lambda each: squared(jnp.moveaxis(each, 0, 1)))(start)


def _put(place: Array, room: Array, a: Array) -> Array:
    return lax.dynamic_update_index_in_dim(room, a, place, 0)


def rows(go: Ways, signals: int) -> Any:
    """Room for what is recorded, and one place more, or as many as ticks go together, for what is written in vain."""
    shape = go.shape
    if not shape.recorded:
        return ()
    ticks, cells = len(go.given.arrivals), shape.cells
    places = -(-ticks // shape.every) + 1 if go.sparse else ticks + go.many
    others = signals if shape.recorded == COVARIANCE else 1
    return Recorded(jnp.zeros((places, signals, cells)), jnp.zeros((places, signals, others, cells)))


def recorded(go: Ways, rows: Any) -> Any:
    """Return what was recorded without the room for what was written in vain."""
    ticks, every = len(go.given.arrivals), go.shape.every
    return jax.tree.map(lambda a: a[:-1] if go.sparse else a[:ticks:every], rows)


def _record(go: Ways, rows: Recorded, k: Array, until: Array, read: Read) -> Recorded:
    """Write down the moments of ticks k and after."""
    mean, every, many = read.runs.errors[:, 0], go.shape.every, go.many
    Z, wide = mean.shape[1], rows.covariance.shape[2] > 1
    new = Recorded(mean, read.covariance[:, :Z, :Z] if wide else sums_of.variances(read)[:, :Z, None])
    write = lax.dynamic_update_slice_in_dim
    if not go.sparse:  # all of them; what is not yet so is written over in time
        return jax.tree.map(lambda room, a: write(room, a, k, 0), rows, new)
    place = -k % every
    row = jnp.where(k + place < until, (k + place) // every, len(rows.mean) - 1)
    one = jax.tree.map(lambda a: lax.dynamic_slice_in_dim(a, jnp.minimum(place, many - 1), 1), new)
    return jax.tree.map(lambda room, a: write(room, a, row, 0), rows, one)
