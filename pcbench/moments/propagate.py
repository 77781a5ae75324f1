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
from pcbench.moments.error_sums import RunSignals, Sums, TickValues
from pcbench.moments.events import Batch, BatchState, Shape, apply_events, make_batch, sense, take_samples
from pcbench.moments.inputs import SCALES, MomentInputs, Numbers, initial_run
from pcbench.moments.noise_state import (
    Form,
    is_constant,
    jacobian,
    outer_square,
    product,
    transpose_cells,
    vector,
    with_tangent,
)
from pcbench.simulation import command_network, innovation_stats, simulate_runs
from pcbench.simulation.closed_loop import add_command_noise, tracking_error
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, Layout, present

COVARIANCE = "covariance"


class MomentRecord(NamedTuple):
    """Moments at T ticks, 0 and every m-th after it; Z signals of all observers, one after another."""

    mean: Numbers  # [T, Z, C]
    covariance: Numbers  # [T, Z, Z, C], or variances [T, Z, 1, C]


class FinalCovariances(NamedTuple):
    """Tick N - 1: the true moments of the errors, and the covariances that observers assume."""

    covariance: Numbers  # [Z, Z, C]
    assumed: dict[str, Numbers]  # [z, z, C] by observer with a covariance, for the signals it estimates


class PropagationState(NamedTuple):
    """The state of a propagation between ticks."""

    state: BatchState
    matrix: Array  # [A + V, A + w, C] of the last tick
    probe: Array | tuple[()]  # [A + V, C] of the matrix with fixed numbers; (): the matrix is constant
    sums: Sums
    rows: MomentRecord | tuple[()]
    final: FinalCovariances | tuple[()]  # if the layout has consistency


class Outcome(NamedTuple):
    """The results of a batch."""

    sums: Sums
    rows: MomentRecord | tuple[()]  # (): nothing recorded
    final: FinalCovariances | tuple[()] = ()
    mode_difference: Numbers | tuple[()] = ()  # [C] of modes, as in `events.BatchState`
    # [2, n, C] of the final state: its size, and its deviation without the effect of the initial state
    final_state: Array | tuple[()] = ()


def run(layout: Layout, shape: Shape, inputs: MomentInputs) -> Outcome:
    """Return the moments of a batch of grid points over ticks 0 .. N - 1, or 0 .. N if recorded."""
    batch = make_batch(layout, shape, inputs)
    schedule, end = inputs.schedule, inputs.problem.windows[-1, 1]
    stop = end + 1 if shape.record else end

    def segment(carry: tuple[Array, PropagationState]) -> tuple[Array, PropagationState]:
        number, c = carry
        k, event = schedule.ticks[number], jax.tree.map(lambda a: a[number], schedule.events)
        c = c._replace(state=apply_events(batch, k, event, c.state, inputs.arrivals[k]))
        stop_tick = jnp.minimum(schedule.ticks[number + 1], stop)
        _, c = lax.while_loop(lambda kc: kc[0] < stop_tick, lambda kc: (kc[0] + 1, tick(batch, *kc)), (k, c))
        return number + 1, c

    start = jnp.asarray(0), initial_propagation(batch)
    _, c = lax.while_loop(lambda carry: schedule.ticks[carry[0]] < stop, segment, start)
    size = jnp.max(jnp.abs(c.state.runs.x), 0)  # the state comes first in the vector
    variance = jnp.einsum("ddc->dc", c.state.P)[: len(size)] if shape.form.noisy[0] else jnp.zeros_like(size)
    final_state = jnp.stack([size, jnp.sqrt(jnp.maximum(variance, 0.0))])
    rows = jax.tree.map(lambda a: a[:-1], c.rows)  # without the place for ticks that are not recorded
    return Outcome(c.sums, rows, c.final, c.state.mode_difference, final_state)


def initial_propagation(batch: Batch) -> PropagationState:
    """Return the propagation state before tick 0; packets from before measure the initial state."""
    batch_inputs, shape, layout, p = batch.inputs, batch.shape, batch.layout, batch.inputs.problem
    cells, zero, form = shape.cells, jnp.asarray(0), shape.form
    n, q, n_scales = p.x0.shape[0], batch.std.shape[0], len(SCALES)
    draws = jnp.broadcast_to(batch_inputs.start[:, :, None], (n_scales, 2 * n, cells))
    start = partial(initial_run, layout)
    starts = jnp.concatenate([jnp.zeros_like(draws[:1]), draws])
    runs = jax.vmap(lambda e: batch.map_cells(start)(zero, (), e, ()))(starts)

    def effects(p: GridPointParams, k: Array, state: PyTree, e: Array, inputs: PyTree) -> Array:
        return jax.jacfwd(lambda e: vector(form, start(p, k, (), e, ())))(e)

    B = batch.map_cells(effects)(zero, (), starts[0], ())
    mean = jax.tree.map(lambda a: a[0], runs)
    packet = batch.map_cells(partial(sense, layout))(zero, mean, jnp.zeros((0, cells)), ())
    places, f, A = layout.ring + 1, packet.shape[0], B.shape[0]
    D = A + places * f * form.flight
    random_columns = [i for i in range(2 * n) if (layout.random_initial_state if i < n else layout.scattered)]
    shifts = jnp.concatenate([jnp.sum(B[None] * draws[:, None], 2), jnp.moveaxis(B[:, random_columns], 1, 0)])
    batch_state = BatchState(
        runs=runs,
        flight=jnp.zeros((1 + n_scales, places, f, cells)),
        P=jnp.zeros((D, D, cells)),
        shifts=jnp.zeros((len(shifts), D, cells)).at[:, :A].set(shifts),
        mode_difference=jnp.zeros(cells),
    )
    is_snapshot = jnp.broadcast_to((jnp.arange(f) >= q)[None, :, None], (places, f, cells))
    batch_state = take_samples(batch, zero, batch_state, is_snapshot)
    for place in range(batch_inputs.schedule.early.shape[0]):
        has_sample = jnp.any(batch_inputs.schedule.early[place] >= 0, 0)
        mask = (jnp.arange(places)[:, None] == place) & (jnp.arange(f) < q)[None]
        batch_state = take_samples(batch, zero, batch_state, mask[:, :, None] & has_sample[None, None])
    network = tuple(stream[0] for stream in batch_inputs.network) if layout.pending else ()
    none = jnp.zeros((batch_inputs.ticks.shape[2], cells))
    one, matrix = partial(one_cell, layout), _matrix(batch)
    _, signals = jax.eval_shape(batch.map_cells(one), zero, mean, none, network)
    is_steady = is_constant(p, shape.per_cell, jacobian(form, one, partial(tick_vector, form)), mean, none, network)
    new = jax.eval_shape(matrix, zero, mean, none, network)
    M = matrix(zero, mean, none, network) if is_steady else jnp.zeros(new.shape)
    probe = () if is_steady else jnp.full((len(M), cells), jnp.nan)
    Z = len(signals.errors)
    rows: MomentRecord | tuple[()] = ()
    final: FinalCovariances | tuple[()] = ()
    if shape.record:
        T = -(-len(batch_inputs.arrivals) // shape.interval) + 1  # one place more for ticks that are not recorded
        rows = MomentRecord(jnp.zeros((T, Z, cells)), jnp.zeros((T, Z, Z if shape.record == COVARIANCE else 1, cells)))
    if layout.consistency:
        covariances = batch.map_cells(partial(_assumed_covariances, layout))
        assumed = jax.eval_shape(covariances, zero, mean, jnp.zeros((0, cells)), ())
        zeros = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), assumed)
        final = FinalCovariances(jnp.zeros((Z, Z, cells)), zeros)
    sums = error_sums.zero_sums(Z, len(signals.tracking), cells)
    return PropagationState(batch_state, M, probe, sums, rows, final)


def tick(batch: Batch, k: Array, c: PropagationState) -> PropagationState:
    """Propagate one tick of all grid points: estimate, control and flow, with the sums."""
    inputs, shape, layout, state, w = batch.inputs, batch.shape, batch.layout, c.state, batch.inputs.ticks[k]
    p = inputs.problem
    network = tuple(stream[k // p.network.period_ticks] for stream in inputs.network) if layout.pending else ()
    noise = jnp.broadcast_to(w[:, :, None], (*w.shape, shape.cells))
    run_noise = jnp.concatenate([jnp.zeros_like(noise[:1]), noise])
    runs, signals, M, probe = _flow(batch, k, state.runs, run_noise, network, c)
    A, Z = M.shape[1] - w.shape[1], signals.errors.shape[1]
    N, M_z, S = M[:, A:], M[:, :A], M[A:, :A]
    shifts = jax.vmap(lambda d: product(M_z, d[:A, None])[:, 0])(state.shifts)
    shifts = shifts.at[: len(w)].add(jnp.sum(N[None] * w[:, None, :, None], 2))
    X, start = product(M_z, state.P[:A]), jnp.moveaxis(shifts[len(w) :, A:], 0, 1)
    if shape.record == COVARIANCE or layout.consistency or layout.controller:
        covariance = product(X[A:, :A], transpose_cells(S)) + outer_square(N[A:]) + outer_square(start)
    else:  # variances only
        covariance = (jnp.sum(X[A:, :A] * S, 1) + jnp.sum(N[A:] ** 2, 1) + jnp.sum(start**2, 1))[:, None]
    P = state.P.at[:A, :A].set(product(X[:A, :A], transpose_cells(M_z[:A])) + outer_square(N[:A]))
    if len(P) > A:  # packets in flight do not change
        P = P.at[:A, A:].set(X[:A, A:]).at[A:, :A].set(transpose_cells(X[:A, A:]))
    values = TickValues(signals, covariance, shifts[: len(w), A:])
    rows, final = c.rows, c.final
    if rows:
        row = jnp.where(k % shape.interval == 0, k // shape.interval, len(rows.mean) - 1)
        new = MomentRecord(signals.errors[0], covariance[:Z, : rows.covariance.shape[2]])
        rows = jax.tree.map(lambda table, a: table.at[row].set(a), rows, new)
    if layout.consistency:
        no_noise, mean = jnp.zeros((0, shape.cells)), jax.tree.map(lambda a: a[0], state.runs)
        covariances = batch.map_cells(partial(_assumed_covariances, layout))
        final = lax.cond(
            k == p.windows[-1, 1] - 1,
            lambda: FinalCovariances(covariance[:Z, :Z], covariances(k, mean, no_noise, ())),
            lambda: c.final,
        )
    counts = jnp.stack([k < p.windows[-1, 1], (k < p.windows[-1, 1]) & (k >= p.windows[0, 1])])
    sums = error_sums.add_tick(c.sums, values, counts, p.weights, k)
    state = state._replace(runs=runs, shifts=state.shifts.at[:, :A].set(shifts[:, :A]), P=P)
    return PropagationState(state, M, probe, sums, rows, final)


def _flow(
    batch: Batch, k: Array, runs: Run, noise: Array, network: tuple[Array, ...], c: PropagationState
) -> tuple[Run, RunSignals, Array, Array | tuple[()]]:
    """Return the runs after a tick, their signals, the tick's matrix, and the product that shows whether it changed."""
    form, one = batch.shape.form, partial(one_cell, batch.layout)
    if isinstance(c.probe, tuple):
        return *jax.vmap(lambda state, w: batch.map_cells(one)(k, state, w, network))(runs, noise), c.matrix, ()
    size, cells = c.matrix.shape[1:]
    A = size - noise.shape[1]
    direction = jnp.asarray(np.random.default_rng(size).normal(size=size))
    direction = jnp.broadcast_to(direction[:, None], (size, cells))
    (new, signals), tangent = jax.vmap(
        lambda state, w: batch.map_cells(with_tangent(form, one))(k, state, w, network, direction[:A], direction[A:])
    )(runs, noise)
    probe = jax.vmap(partial(tick_vector, form), -1, -1)(jax.tree.map(lambda a: a[0], tangent))
    M = lax.cond(
        jnp.any(probe != c.probe),
        lambda: _matrix(batch)(k, jax.tree.map(lambda a: a[0], runs), noise[0], network),
        lambda: c.matrix,
    )
    return new, signals, M, probe


def _matrix(batch: Batch) -> Callable[..., Array]:
    """Return the function for the matrix of a tick: (k, mean, no noise, late) -> [A + V, A + w, C]."""
    form = batch.shape.form
    return batch.map_cells(jacobian(form, partial(one_cell, batch.layout), partial(tick_vector, form)))


def one_cell(
    layout: Layout, p: GridPointParams, k: Array, run: Run, noise: Array, network: tuple[Array, ...]
) -> tuple[Run, RunSignals]:
    """Propagate one grid point by one tick with `simulate_runs.advance`, and return its signals."""
    process, p, loop, none = p.process_std.shape[0], p._replace(weights=()), layout.controller, jnp.zeros(0)
    command = command_network.CommandDraws(network[0], network[1], noise[process:]) if layout.pending else ()

    def signals_of(k: Array, run: Run) -> RunSignals:
        return RunSignals(
            errors=jnp.concatenate([e for _, e in sorted(simulate_runs.errors(layout, p, p.params, k, run).items())]),
            tracking=tracking_error(loop, p, k, run.x) if loop else none,
            x=run.x if loop else none,
            u=add_command_noise(present(p, k, True, run.commands), run.commands).u if loop else none,
        )

    new, signals = simulate_runs.advance(layout, p, p.params, k, run, noise[:process], command, signals_of)
    return jax.tree.map(lambda a, b: jnp.asarray(a).astype(jnp.result_type(b)), new, run), signals


def tick_vector(form: Form, state_and_signals: tuple[Run, RunSignals]) -> Array:
    """Return the vector of the state, followed by all signals."""
    return jnp.concatenate([vector(form, state_and_signals[0]), *state_and_signals[1]])


def _assumed_covariances(
    layout: Layout, p: GridPointParams, k: Array, run: Run, noise: Array, inputs: tuple[()]
) -> dict[str, Array]:
    """Return the covariances that the observers of one grid point assume at tick k."""
    return innovation_stats.covariances(layout, p, k, run.memories, run.commands)
