"""One observer over a block of ticks of a recording: the tick of `simulation.simulate_runs` without plant and network.

The state is the recorded truth, if known, and measurements come with the packet. A tick is: take snapshots of samples, deliver
arrivals, add errors, flow.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Arrival, Plant
from pcbench.recordings.windows import Window
from pcbench.runtime import program_cache
from pcbench.simulation import metrics, rng, simulate_runs, trajectory
from pcbench.simulation.metrics import ErrorSums, SettlingState
from pcbench.simulation.simulate_runs import Run, select
from pcbench.simulation.types import GridPointParams, Layout, present

N_STATS = 4  # numbers of an InnovationStats; two per channel follow: nu / sigma of all, then sigma of all


class Score(NamedTuple):
    """Error sums over ticks with known truth."""

    before: ErrorSums  # before the tail, and in it
    tail: ErrorSums
    watch: SettlingState
    final: Array  # [n] last error
    counts: Array  # [2, n] ticks with known truth, before the tail and in it


class TickOutputs(NamedTuple):
    """The recorded values of every tick of a block."""

    estimate: Array  # [K, n]
    sigma: Array  # [K, n] assumed standard deviations of the errors; [K, 0]: none, or not requested
    innovation_stats: Array  # [K, S, N_STATS + 2 q] innovation statistics of packets; [K, S, 0]: not reported
    delay: Array  # [K, 1] s, estimated; [K, 0]: not estimated


PLANT = Plant(step=lambda params, now, x: x, output=lambda params, now, x: params)  # no motion, no measurement


def init_run(layout: Layout, p: GridPointParams, with_score: bool, seed: Array) -> tuple[Run, Score | None]:
    """Return the observer before tick 0, and an empty score; None: no score."""
    run = simulate_runs.run_from(layout, p, jnp.asarray(p.x0), p.xhat0, rng.words(jnp.asarray(0), seed[None])[:, 0])
    if not with_score:
        return run, None
    ((label, o),) = layout.observers
    n = o.estimate(p.gains[label], run.memories[label]).shape[0] + layout.plant.scored
    return run, Score(
        metrics.zero_sums(n),
        metrics.zero_sums(n),
        metrics.initial_settling(n),
        final=jnp.full(n, jnp.nan),
        counts=jnp.zeros((2, n)),
    )


def with_variances(run: Run) -> Run:
    """Return a run before tick 0 whose observers have room for the variance of each stored sample."""

    def with_room(node: PyTree) -> PyTree:
        return node._replace(variance_ratio=jnp.ones(node.mask.shape)) if isinstance(node, Measurement) else node

    return jax.tree.map(with_room, run, is_leaf=lambda node: isinstance(node, Measurement))


def run_block(
    layout: Layout,
    p: GridPointParams,
    start: Run,
    score: Score | None,
    ticks: Array,
    window: Window,
    truth: Array,
    ends: Array,
) -> tuple[Run, Score | None, TickOutputs]:
    """Run the observer over `ticks` [K]; `ends` are the first tick of the tail, and the last tick, which is not scored."""
    ((label, o),) = layout.observers
    no_stats = jnp.zeros((window.arrive.shape[1], N_STATS + 2 * len(p.params) if o.innovation else 0))

    def step(
        carry: tuple[Run, Score | None], row: tuple[Array, Window, Array]
    ) -> tuple[tuple[Run, Score | None], TickOutputs]:
        (run, score), (k, window, x) = carry, row
        run = run._replace(x=x) if x.shape[0] else run
        apply = partial(apply_events, layout, p, window, k, no_stats)
        run, stats = lax.cond(window.event, apply, lambda run: (run, no_stats), run)
        memory = run.memories[label]
        delay = o.delay(p.gains[label], memory, present(p, k, False))[:1] if o.delay else jnp.zeros(0)
        sigma = trajectory.sigma(layout, p, k, run).get(label, jnp.zeros(0))
        outputs = TickOutputs(o.estimate(p.gains[label], memory), sigma, stats, delay)
        if score is not None:
            e = simulate_runs.errors(layout, p, p.params, k, run)[label]
            score = _update_score(p, score, k, ~jnp.isnan(x[: len(e)]), e, ends)
        return (simulate_runs.flow(layout, p, p.params, k, run, jnp.zeros(0)), score), outputs

    (run, score), block_outputs = lax.scan(step, (start, score), (ticks, window, truth))
    return run, score, block_outputs


def apply_events(
    layout: Layout, p: GridPointParams, window: Window, k: Array, no_stats: Array, run: Run
) -> tuple[Run, Array]:
    """Apply the events of tick k: snapshots of samples, then arrivals, the oldest packet first."""
    ((label, o),) = layout.observers
    place, has_sample, sampled = window.sense % layout.ring, jnp.asarray(window.sense >= 0), jnp.asarray(window.sampled)
    snapshots = simulate_runs.take_snapshots(layout, p, k, run.memories, run.commands)
    stored = jax.tree.map(
        lambda ring, new: ring.at[place].set(jnp.where(has_sample, new, ring[place])), run.flight.snapshots, snapshots
    )
    memories = select(has_sample, simulate_runs.notify(layout, p, k, run, sampled), run.memories)
    run = run._replace(memories=memories, flight=run.flight._replace(snapshots=stored))

    def deliver(slot: Array, carry: tuple[Run, Array]) -> tuple[Run, Array]:
        def jump(carry: tuple[Run, Array]) -> tuple[Run, Array]:
            run, packet_stats = carry
            packet = jax.tree.map(lambda ring: ring[window.arrive[slot] % layout.ring], run.flight.snapshots)
            age, since = (
                jnp.full(window.mask[slot].shape, k - window.sampling_ticks[slot]),
                window.ticks_since_arrival[slot],
            )
            ratio = None if window.variance_ratio is None else window.variance_ratio[slot]
            arrival = partial(
                Arrival,
                window.value[slot],
                window.mask[slot],
                age,
                window.number[slot],
                ticks_since_arrival=since,
                variance_ratio=ratio,
            )
            if o.innovation:  # NaN: a skipped sample
                stats = o.innovation(p.gains[label], run.memories[label], present(p, k, False), arrival(packet[label]))
                unknown = jnp.full(window.mask[slot].shape, jnp.nan)
                by_channel = [unknown if numbers is None else numbers for numbers in (stats.normalized, stats.sigma)]
                total = [jnp.asarray(jnp.nan if number is None else number) for number in stats[:N_STATS]]
                packet_stats = packet_stats.at[slot].set(jnp.concatenate([jnp.stack(total), *by_channel]))
            return run._replace(memories=simulate_runs.jump(layout, p, k, run, packet, arrival)), packet_stats

        return lax.cond(window.arrive[slot] >= 0, jump, lambda carry: carry, carry)

    result: tuple[Run, Array] = lax.fori_loop(0, window.arrive.shape[0], deliver, (run, no_stats))
    return result


def _update_score(p: GridPointParams, score: Score, k: Array, has_truth: Array, e: Array, ends: Array) -> Score:
    """Return the score after the errors e [n] of tick k, where truth is known [n]."""
    is_scored, in_tail = has_truth & (k < ends[1]), k >= ends[0]
    e = jnp.where(is_scored, e, 0.0)  # adds nothing to the sums
    return Score(
        before=metrics.add_error(score.before, jnp.where(in_tail, 0.0, e)),
        tail=metrics.add_error(score.tail, jnp.where(in_tail, e, 0.0)),
        watch=metrics.update_settling(score.watch, k, e, p.band, p.bound, p.jumps),
        final=jnp.where(is_scored, e, score.final),
        counts=score.counts + jnp.stack([is_scored & ~in_tail, is_scored & in_tail]),
    )


def estimated_delay(layout: Layout, p: GridPointParams, run: Run, k: Array) -> Array:
    """Return the estimated delay and its standard deviation [s]; 0 if the observer estimates none."""
    ((label, o),) = layout.observers
    return o.delay(p.gains[label], run.memories[label], present(p, k, False)) if o.delay else jnp.zeros(2)


@cache
def jit_delay() -> Callable[..., Array]:
    """Return `estimated_delay` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(estimated_delay, 0)


@cache
def jit_step_block() -> tuple[
    Callable[..., tuple[Run, Score | None]], Callable[..., tuple[Run, Score | None, TickOutputs]]
]:
    """Return `init_run` and `run_block` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(init_run, (0, 2)), program_cache.jit_with_limit(run_block, 0)
