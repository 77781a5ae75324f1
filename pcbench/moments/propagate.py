"""The program of exact moments: propagate a batch of grid points from tick 0 to the end.

The loop is that of `engine.event_loop`: samples and arrivals at an event, then flow to the next. Propagated are

- the run without noise, and a run with noise (`exactness`)
- the effect of each random number of the initial state
- the covariance of the effects of all other noise

The initial state may be much larger than the remaining errors, so its effects are kept separate: the difference of effects on
state and estimate keeps its digits, the difference of their squares does not.

With z the vector that noise reaches, s the signals read at a tick and w the noise of a tick, M is the matrix of the map
(z, w) -> (z+, s). It is constant, or recomputed when one product with it differs from the last tick's.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.moments import error_sums
from pcbench.moments.error_sums import Read, RunSignals, Sums
from pcbench.moments.events import Batch, Moving, Shape, batch, happen, sense, take_samples
from pcbench.moments.inputs import SCALES, MomentInputs, Numbers, begin
from pcbench.moments.noise_state import Form, along, outer_square, product, slope, steady, transpose_cells, vector
from pcbench.simulation import command_network, innovation_stats, simulate_runs
from pcbench.simulation.closed_loop import add_command_noise, off_target
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, Layout, present

COVARIANCE = "covariance"


class MomentRecord(NamedTuple):
    """Moments at T ticks, 0 and every m-th after it; Z signals of all observers, one after another."""

    mean: Numbers  # [T, Z, C]
    covariance: Numbers  # [T, Z, Z, C], or variances [T, Z, 1, C]


class Last(NamedTuple):
    """Tick N - 1: the true moments of the errors, and the covariances that observers assume."""

    covariance: Numbers  # [Z, Z, C]
    assumed: dict[str, Numbers]  # [z, z, C] by observer with a covariance, for the signals it estimates


class PropagationState(NamedTuple):
    """The state of a propagation between ticks."""

    moving: Moving
    matrix: Array  # [A + V, A + w, C] of the last tick
    product: Array | tuple[()]  # [A + V, C] of the matrix with fixed numbers; (): the matrix is constant
    sums: Sums
    rows: MomentRecord | tuple[()]
    last: Last | tuple[()]  # if the layout has consistency


class Outcome(NamedTuple):
    """The results of a batch."""

    sums: Sums
    rows: MomentRecord | tuple[()]  # (): nothing recorded
    last: Last | tuple[()] = ()
    unlike: Numbers | tuple[()] = ()  # [C] of modes, as in `events.Moving`
    reached: (
        Array | tuple[()]
    ) = ()  # [2, n, C] of the final state: its size, and its deviation without the effect of the initial state


def run(layout: Layout, shape: Shape, given: MomentInputs) -> Outcome:
    """Return the moments of a batch of grid points over ticks 0 .. N - 1, or 0 .. N if recorded."""
    by = batch(layout, shape, given)
    plan, end = given.plan, given.problem.windows[-1, 1]
    stop = end + 1 if shape.recorded else end

    def segment(at: tuple[Array, PropagationState]) -> tuple[Array, PropagationState]:
        number, c = at
        k, now = plan.at[number], jax.tree.map(lambda a: a[number], plan.events)
        c = c._replace(moving=happen(by, k, now, c.moving, given.arrivals[k]))
        until = jnp.minimum(plan.at[number + 1], stop)
        _, c = lax.while_loop(lambda at: at[0] < until, lambda at: (at[0] + 1, tick(by, *at)), (k, c))
        return number + 1, c

    _, c = lax.while_loop(lambda at: plan.at[at[0]] < stop, segment, (jnp.asarray(0), first(by)))
    size = jnp.max(jnp.abs(c.moving.runs.x), 0)  # the state comes first in the vector
    variance = jnp.einsum("ddc->dc", c.moving.P)[: len(size)] if shape.form.moving[0] else jnp.zeros_like(size)
    reached = jnp.stack([size, jnp.sqrt(jnp.maximum(variance, 0.0))])
    rows = jax.tree.map(lambda a: a[:-1], c.rows)  # without the place for ticks that are not recorded
    return Outcome(c.sums, rows, c.last, c.moving.unlike, reached)


def first(by: Batch) -> PropagationState:
    """Return the propagation state before tick 0; packets from before measure the initial state."""
    given, shape, layout, p = by.given, by.shape, by.layout, by.given.problem
    cells, zero, form = shape.cells, jnp.asarray(0), shape.form
    n, q, many = p.x0.shape[0], by.std.shape[0], len(SCALES)
    drawn = jnp.broadcast_to(given.start[:, :, None], (many, 2 * n, cells))
    start = partial(begin, layout)
    entering = jnp.concatenate([jnp.zeros_like(drawn[:1]), drawn])
    runs = jax.vmap(lambda e: by.over(start)(zero, (), e, ()))(entering)

    def effects(p: GridPointParams, k: Array, state: PyTree, e: Array, rest: PyTree) -> Array:
        return jax.jacfwd(lambda e: vector(form, start(p, k, (), e, ())))(e)

    B = by.over(effects)(zero, (), entering[0], ())
    mean = jax.tree.map(lambda a: a[0], runs)
    packet = by.over(partial(sense, layout))(zero, mean, jnp.zeros((0, cells)), ())
    places, f, A = layout.ring + 1, packet.shape[0], B.shape[0]
    D = A + places * f * form.flight
    random = [at for at in range(2 * n) if (layout.random_initial_state if at < n else layout.scattered)]
    shifts = jnp.concatenate([jnp.sum(B[None] * drawn[:, None], 2), jnp.moveaxis(B[:, random], 1, 0)])
    m = Moving(
        runs=runs,
        flight=jnp.zeros((1 + many, places, f, cells)),
        P=jnp.zeros((D, D, cells)),
        apart=jnp.zeros((len(shifts), D, cells)).at[:, :A].set(shifts),
        unlike=jnp.zeros(cells),
    )
    m = take_samples(by, zero, m, jnp.broadcast_to((jnp.arange(f) >= q)[None, :, None], (places, f, cells)))
    for place in range(given.plan.early.shape[0]):
        there = jnp.any(given.plan.early[place] >= 0, 0)
        here = (jnp.arange(places)[:, None] == place) & (jnp.arange(f) < q)[None]
        m = take_samples(by, zero, m, here[:, :, None] & there[None, None])
    late = tuple(each[0] for each in given.network) if layout.pending else ()
    none = jnp.zeros((given.ticks.shape[2], cells))
    one, matrix = partial(one_cell, layout), _matrix(by)
    _, seen = jax.eval_shape(by.over(one), zero, mean, none, late)
    is_steady = steady(p, shape.own, slope(form, one, partial(flat, form)), mean, none, late)
    new = jax.eval_shape(matrix, zero, mean, none, late)
    M = matrix(zero, mean, none, late) if is_steady else jnp.zeros(new.shape)
    shown = () if is_steady else jnp.full((len(M), cells), jnp.nan)
    Z = len(seen.errors)
    rows: MomentRecord | tuple[()] = ()
    last: Last | tuple[()] = ()
    if shape.recorded:
        T = -(-len(given.arrivals) // shape.every) + 1  # one place more for ticks that are not recorded
        rows = MomentRecord(
            jnp.zeros((T, Z, cells)), jnp.zeros((T, Z, Z if shape.recorded == COVARIANCE else 1, cells))
        )
    if layout.consistency:
        assumed = jax.eval_shape(by.over(partial(_assumed_covariances, layout)), zero, mean, jnp.zeros((0, cells)), ())
        last = Last(jnp.zeros((Z, Z, cells)), jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), assumed))
    return PropagationState(m, M, shown, error_sums.nothing(Z, len(seen.off), cells), rows, last)


def tick(by: Batch, k: Array, c: PropagationState) -> PropagationState:
    """Propagate one tick of all grid points: estimate, control and flow, with the sums."""
    given, shape, layout, m, w = by.given, by.shape, by.layout, c.moving, by.given.ticks[k]
    late = tuple(each[k // given.problem.network.every] for each in given.network) if layout.pending else ()
    noise = jnp.broadcast_to(w[:, :, None], (*w.shape, shape.cells))
    runs, seen, M, shown = _flow(by, k, m.runs, jnp.concatenate([jnp.zeros_like(noise[:1]), noise]), late, c)
    A, Z = M.shape[1] - w.shape[1], seen.errors.shape[1]
    N, M_z, S = M[:, A:], M[:, :A], M[A:, :A]
    apart = jax.vmap(lambda d: product(M_z, d[:A, None])[:, 0])(m.apart)
    apart = apart.at[: len(w)].add(jnp.sum(N[None] * w[:, None, :, None], 2))
    X, start = product(M_z, m.P[:A]), jnp.moveaxis(apart[len(w) :, A:], 0, 1)
    if shape.recorded == COVARIANCE or layout.consistency or layout.controller:
        covariance = product(X[A:, :A], transpose_cells(S)) + outer_square(N[A:]) + outer_square(start)
    else:  # variances only
        covariance = (jnp.sum(X[A:, :A] * S, 1) + jnp.sum(N[A:] ** 2, 1) + jnp.sum(start**2, 1))[:, None]
    P = m.P.at[:A, :A].set(product(X[:A, :A], transpose_cells(M_z[:A])) + outer_square(N[:A]))
    if len(P) > A:  # packets in flight do not change
        P = P.at[:A, A:].set(X[:A, A:]).at[A:, :A].set(transpose_cells(X[:A, A:]))
    read, p = Read(seen, covariance, apart[: len(w), A:]), given.problem
    rows, last = c.rows, c.last
    if rows:
        row = jnp.where(k % shape.every == 0, k // shape.every, len(rows.mean) - 1)
        new = MomentRecord(seen.errors[0], covariance[:Z, : rows.covariance.shape[2]])
        rows = jax.tree.map(lambda room, a: room.at[row].set(a), rows, new)
    if layout.consistency:
        here, mean = jnp.zeros((0, shape.cells)), jax.tree.map(lambda a: a[0], m.runs)
        last = lax.cond(
            k == p.windows[-1, 1] - 1,
            lambda: Last(covariance[:Z, :Z], by.over(partial(_assumed_covariances, layout))(k, mean, here, ())),
            lambda: c.last,
        )
    counts = jnp.stack([k < p.windows[-1, 1], (k < p.windows[-1, 1]) & (k >= p.windows[0, 1])])
    sums = error_sums.add_tick(c.sums, read, counts, p.weights, k)
    return PropagationState(
        m._replace(runs=runs, apart=m.apart.at[:, :A].set(apart[:, :A]), P=P), M, shown, sums, rows, last
    )


def _flow(
    by: Batch, k: Array, runs: Run, noise: Array, late: tuple[Array, ...], c: PropagationState
) -> tuple[Run, RunSignals, Array, Array | tuple[()]]:
    """Return the runs after a tick, their signals, the tick's matrix, and the product that shows whether it changed."""
    form, one = by.shape.form, partial(one_cell, by.layout)
    if isinstance(c.product, tuple):
        return *jax.vmap(lambda state, w: by.over(one)(k, state, w, late))(runs, noise), c.matrix, ()
    many, cells = c.matrix.shape[1:]
    A = many - noise.shape[1]
    fixed = jnp.asarray(np.random.default_rng(many).normal(size=many))
    fixed = jnp.broadcast_to(fixed[:, None], (many, cells))
    (new, seen), tangent = jax.vmap(
        lambda state, w: by.over(along(form, one))(k, state, w, late, fixed[:A], fixed[A:])
    )(runs, noise)
    shown = jax.vmap(partial(flat, form), -1, -1)(jax.tree.map(lambda a: a[0], tangent))
    M = lax.cond(
        jnp.any(shown != c.product),
        lambda: _matrix(by)(k, jax.tree.map(lambda a: a[0], runs), noise[0], late),
        lambda: c.matrix,
    )
    return new, seen, M, shown


def _matrix(by: Batch) -> Callable[..., Array]:
    """Return the function for the matrix of a tick: (k, mean, no noise, late) -> [A + V, A + w, C]."""
    return by.over(slope(by.shape.form, partial(one_cell, by.layout), partial(flat, by.shape.form)))


def one_cell(
    layout: Layout, p: GridPointParams, k: Array, run: Run, noise: Array, late: tuple[Array, ...]
) -> tuple[Run, RunSignals]:
    """Propagate one grid point by one tick with `simulate_runs.advance`, and return its signals."""
    process, p, loop, none = p.process_std.shape[0], p._replace(weights=()), layout.controller, jnp.zeros(0)
    command = command_network.CommandDraws(late[0], late[1], noise[process:]) if layout.pending else ()

    def read(k: Array, run: Run) -> RunSignals:
        return RunSignals(
            errors=jnp.concatenate([e for _, e in sorted(simulate_runs.errors(layout, p, p.params, k, run).items())]),
            off=off_target(loop, p, k, run.x) if loop else none,
            x=run.x if loop else none,
            u=add_command_noise(present(p, k, True, run.commands), run.commands).u if loop else none,
        )

    new, seen = simulate_runs.advance(layout, p, p.params, k, run, noise[:process], command, read)
    return jax.tree.map(lambda a, b: jnp.asarray(a).astype(jnp.result_type(b)), new, run), seen


def flat(form: Form, state_and_seen: tuple[Run, RunSignals]) -> Array:
    """Return the vector of the state, followed by all signals."""
    return jnp.concatenate([vector(form, state_and_seen[0]), *state_and_seen[1]])


def _assumed_covariances(
    layout: Layout, p: GridPointParams, k: Array, run: Run, nothing: Array, rest: tuple[()]
) -> dict[str, Array]:
    """Return the covariances that the observers of one grid point assume at tick k."""
    return innovation_stats.covariances(layout, p, k, run.memories, run.commands)
