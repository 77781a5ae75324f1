"""Observers over a stretch of a log: the tick of `simulation.simulate_runs`, with the log in place of plant and network.

The state is the truth where the log has it, and what is measured comes with the packet. So a tick is: note what is sampled,
deliver what arrives, take the errors, move the observers.
"""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.protocols import Arrival, Plant
from pcbench.recordings.windows import Window
from pcbench.runtime import program_cache
from pcbench.simulation import metrics, rng, simulate_runs
from pcbench.simulation.simulate_runs import Run, select
from pcbench.simulation.types import GridPointParams, Layout, present

JUDGED = 4  # numbers of a Surprise, which are followed by one for each channel
Surprises = dict[str, Array]  # by observer label of those that say it: how far packets are from what was expected


class Score(NamedTuple):
    """What is kept of errors where truth is known, by observer label; two windows, before the tail and in it."""

    streams: Any  # label -> (metrics.Stream, metrics.Stream)
    watches: Any  # label -> metrics.Watch
    final: Any  # label -> [n] the last error
    counts: Any  # [2] ticks at which truth is known


class Read(NamedTuple):
    """What is seen at every tick of a stretch."""

    estimates: dict[str, Array]  # [K, n]
    surprise: dict[str, Array]  # [K, S, JUDGED + q]


PLANT = Plant(step=lambda params, now, x: x, output=lambda params, now, x: params)  # nothing moves, nothing is measured


def begun(layout: Layout, p: GridPointParams, slots: int, scored: bool, seed: Array) -> tuple[Run, Any]:
    """Return the observers before tick 0, and the score of nothing; (): truth is not asked for."""
    run = simulate_runs.run_from(layout, p, jnp.asarray(p.x0), p.xhat0, rng.words(jnp.asarray(0), seed[None])[:, 0])
    if not scored:
        return run, ()
    size = {label: o.estimate(p.gains[label], run.memories[label]).shape[0] for label, o in layout.observers}
    return run, Score(
        {o: (metrics.start(n), metrics.start(n)) for o, n in size.items()},
        {o: metrics.start_watch(n) for o, n in size.items()},
        {o: jnp.full(n, jnp.nan) for o, n in size.items()},
        jnp.zeros(2),
    )


def run(
    layout: Layout, p: GridPointParams, start: Run, score: Any, ticks: Array, w: Window, truth: Array, ends: Array
) -> tuple[Run, Any, Read]:
    """Take the observers over `ticks` [K]; `ends` are the tick at which the tail begins, and the last, which is not scored."""
    q, able = len(p.params), [label for label, o in layout.observers if o.innovation]
    quiet = {label: jnp.zeros((w.arrive.shape[1], JUDGED + q)) for label in able}

    def step(carry: tuple[Run, Any], row: tuple[Array, Window, Array]) -> tuple[tuple[Run, Any], Read]:
        (run, score), (k, w, x) = carry, row
        run = run._replace(x=x) if x.shape[0] else run
        run, surprise = lax.cond(w.event, partial(events, layout, p, w, k, quiet), lambda run: (run, quiet), run)
        read = Read({o: f.estimate(p.gains[o], run.memories[o]) for o, f in layout.observers}, surprise)
        if score:
            e = simulate_runs.errors(layout, p, p.params, k, run)
            score = _scored(p, score, k, ~jnp.any(jnp.isnan(x)), e, ends)
        return (simulate_runs.flow(layout, p, p.params, k, run, jnp.zeros(0)), score), read

    (run, score), seen = lax.scan(step, (start, score), (ticks, w, truth))
    return run, score, seen


def events(
    layout: Layout, p: GridPointParams, w: Window, k: Array, quiet: Surprises, run: Run
) -> tuple[Run, Surprises]:
    """Let what the log has for tick k happen: note what is sampled, deliver what arrives, the oldest packet first."""
    place, taken, sampled = w.sense % layout.ring, jnp.asarray(w.sense >= 0), jnp.asarray(w.sampled)
    found = simulate_runs.take_notes(layout, p, k, run.memories, run.commands)
    notes = jax.tree.map(
        lambda ring, new: ring.at[place].set(jnp.where(taken, new, ring[place])), run.flight.notes, found
    )
    memories = select(taken, simulate_runs.notify(layout, p, k, run, sampled), run.memories)
    run = run._replace(memories=memories, flight=run.flight._replace(notes=notes))

    def deliver(slot: Array, so_far: tuple[Run, Surprises]) -> tuple[Run, Surprises]:
        def jump(so_far: tuple[Run, Surprises]) -> tuple[Run, Surprises]:
            run, table = so_far
            brought = jax.tree.map(lambda ring: ring[w.arrive[slot] % layout.ring], run.flight.notes)
            age = jnp.full(w.mask[slot].shape, k - w.taken[slot])
            arrival = partial(
                Arrival,
                w.value[slot],
                w.mask[slot],
                age,
                w.number[slot],
                ticks_since_arrival=w.ticks_since_arrival[slot],
            )
            here = surprises(layout, p, k, run, {label: arrival(noted) for label, noted in brought.items()})
            table = {label: each.at[slot].set(here[label]) for label, each in table.items()}
            return run._replace(memories=simulate_runs.jump(layout, p, k, run, brought, arrival)), table

        return lax.cond(w.arrive[slot] >= 0, jump, lambda so_far: so_far, so_far)

    done: tuple[Run, Surprises] = lax.fori_loop(0, w.arrive.shape[0], deliver, (run, quiet))
    return done


def surprises(layout: Layout, p: GridPointParams, k: Array, run: Run, arrivals: dict[str, Arrival]) -> Surprises:
    """Return how far a packet is from what each observer expects of it, [JUDGED + q]; NaN is what one leaves out."""
    now, out = present(p, k, False), {}
    for label, o in layout.observers:
        if o.innovation:
            found = o.innovation(p.gains[label], run.memories[label], now, arrivals[label])
            each = jnp.full(arrivals[label].mask.shape, jnp.nan) if found.each is None else found.each
            whole = [jnp.asarray(jnp.nan if number is None else number) for number in found[:JUDGED]]
            out[label] = jnp.concatenate([jnp.stack(whole), each])
    return out


def _scored(p: GridPointParams, score: Score, k: Array, known: Array, e: dict[str, Array], ends: Array) -> Score:
    """The score with the errors of tick k, if truth is known there."""
    there, late = known & (k < ends[1]), k >= ends[0]

    def kept(new: Any, old: Any, which: Array) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(which, a, b), new, old)

    return Score(
        {
            o: tuple(
                kept(metrics.update(s, e[o]), s, there & (late == tail)) for s, tail in zip(pair, (0, 1), strict=True)
            )
            for o, pair in score.streams.items()
        },
        {o: kept(metrics.look(w, k, e[o], p.band, p.bound, p.jumps), w, there) for o, w in score.watches.items()},
        {o: kept(e[o], final, there) for o, final in score.final.items()},
        score.counts + there * jnp.stack([~late, late]),
    )


@cache
def compiled() -> tuple[Any, Any]:
    """Return `begun` and `run` compiled, once for each shape in a process."""
    return program_cache.bounded(begun, (0, 2, 3)), program_cache.bounded(run, 0)
