"""Observers over a stretch of a log's ticks, in the order of a simulated tick, with `simulation.steps` and nothing of its own.

There is no plant: its state is the truth where a log has it, and what is measured comes with the packet. So a tick is sense
(observers note), deliver, estimate, flow.
"""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.logs.windows import Window
from pcbench.protocols import Plant
from pcbench.simulation import compiling, lanes, metrics
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.problem import Layout, Packet, Problem, State, present
from pcbench.simulation.start import begin
from pcbench.simulation.steps import Drawn, Row, arrival_of, errors, estimates, jump, note, tells, tick, told

JUDGED = 4  # numbers of a Surprise, which are followed by one for each channel


class Flight(NamedTuple):
    """What was noted for packets on their way, in rings; and how far what arrived at this tick was from what was expected."""

    notes: Any  # by observer label, [ring, r]
    surprise: dict[str, Array]  # by observer label of those that say it, [S, JUDGED + q]


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


def begun(layout: Layout, p: Problem, slots: int, scored: bool, seed: Array) -> tuple[State, Any]:
    """Return the state before tick 0, and the score of nothing; (): truth is not asked for."""
    state = begin(layout, p, jnp.asarray(0), seed[None])
    notes = jax.tree.map(lambda v: jnp.broadcast_to(v, (layout.ring, *jnp.shape(v))), state.flight.notes)
    able = [label for label, o in layout.observers if o.innovation]
    state = state._replace(
        flight=Flight(notes, {label: jnp.zeros((slots, JUDGED + len(p.params))) for label in able}),
        streams={},
        watches={},
    )
    if not scored:
        return state, ()
    size = {label: found.shape[0] for label, found in estimates(layout, p, state).items()}
    return state, Score(
        {o: (metrics.start(n), metrics.start(n)) for o, n in size.items()},
        {o: metrics.start_watch(n) for o, n in size.items()},
        {o: jnp.full(n, jnp.nan) for o, n in size.items()},
        jnp.zeros(2),
    )


def run(
    layout: Layout, p: Problem, state: State, score: Any, ticks: Array, w: Window, truth: Array, ends: Array
) -> tuple[State, Any, Read]:
    """Take the observers over `ticks` [K]; `ends` are the tick at which the tail begins, and the last, which is not scored."""

    def step(carry: tuple[State, Any], row: tuple[Array, Window, Array]) -> tuple[tuple[State, Any], Read]:
        (state, score), (k, w, x) = carry, row
        state = state._replace(x=x) if x.shape[0] else state
        new, (seen, e) = tick(layout, p, k, state, NOTHING, partial(happen, layout, p, w), partial(_read, layout, p))
        score = _scored(p, score, k, ~jnp.any(jnp.isnan(x)), e, ends) if score else score
        return (lanes.like(new, state, 1), score), seen

    (state, score), seen = lax.scan(step, (state, score), (ticks, w, truth))
    return state, score, seen


NOTHING = Drawn(jnp.zeros(0))


def happen(layout: Layout, p: Problem, w: Window, k: Array, state: State) -> State:
    """Let what the log has for tick k happen: note what is taken, deliver what arrives, the oldest packet first."""
    quiet = jax.tree.map(jnp.zeros_like, state.flight.surprise)
    return lax.cond(
        w.event,
        lambda state: lanes.like(_events(layout, p, w, k, state), state, 1),
        lambda state: state._replace(flight=state.flight._replace(surprise=quiet)),
        state,
    )


def _events(layout: Layout, p: Problem, w: Window, k: Array, state: State) -> State:
    taken = w.sense >= 0

    def put(ring: Any, new: Any) -> Any:
        place = w.sense % layout.ring
        value = jnp.where(taken, new, ring[place])
        return lax.dynamic_update_index_in_dim(ring, value, place, 0)

    own = state.flight.notes
    noted = lanes.like(note(layout, p, k, state), jax.tree.map(lambda ring: ring[0], own), 1)
    notes = jax.tree.map(put, own, noted)
    if tells(layout):
        after = lambda: lanes.like(told(layout, p, k, state, w.sampled), state.memories, 1)  # noqa: E731
        state = state._replace(memories=lax.cond(taken, after, lambda: state.memories))

    def deliver(slot: Array, so_far: Any) -> Any:
        number = w.arrive[slot]
        brought = jax.tree.map(lambda ring: ring[number % layout.ring], notes)
        packet = Packet(w.value[slot], brought)
        age = jnp.full(w.fresh[slot].shape, k - w.taken[slot])
        row = Row(w.fresh[slot], age, w.number[slot], w.since[slot])

        def jumped(so_far: Any) -> Any:
            memories, table = so_far
            there = state._replace(memories=memories)
            found = surprises(layout, p, k, there, row, packet)
            table = {label: each.at[slot].set(found[label]) for label, each in table.items()}
            return lanes.like(jump(layout, p, k, there, row, packet), memories, 1), table

        return lax.cond(number >= 0, jumped, lambda so_far: so_far, so_far)

    quiet = jax.tree.map(jnp.zeros_like, state.flight.surprise)
    memories, table = lax.fori_loop(0, w.arrive.shape[0], deliver, (state.memories, quiet))
    return state._replace(memories=memories, flight=Flight(notes, table))


def surprises(layout: Layout, p: Problem, k: Array, state: State, row: Row, packet: Packet) -> dict[str, Array]:
    """Return how far a packet is from what each observer expects of it, [JUDGED + q]; NaN is what one leaves out."""
    able = {label: o.innovation for label, o in layout.observers if o.innovation}

    def one_lane(memories: Any, row: Row, packet: Packet) -> dict[str, Array]:
        now, out = present(p, k, False), {}
        for label, innovation in able.items():
            found = innovation(p.gains[label], memories[label], now, arrival_of(row, packet, label))
            each = jnp.full(row.fresh.shape, jnp.nan) if found.each is None else found.each
            whole = [jnp.asarray(jnp.nan if number is None else number) for number in found[:JUDGED]]
            out[label] = jnp.concatenate([jnp.stack(whole), each])
        return out

    return {label: lanes.whole(each, 1)[:, 0] for label, each in over(one_lane)(state.memories, row, packet).items()}


def _read(layout: Layout, p: Problem, k: Array, state: State) -> tuple[Read, Any]:
    found = {label: lanes.whole(xhat, 1)[:, 0] for label, xhat in estimates(layout, p, state).items()}
    e = {label: lanes.whole(each, 1)[:, 0] for label, each in errors(layout, p, k, state).items()}
    return Read(found, state.flight.surprise), e


def _scored(p: Problem, score: Score, k: Array, known: Array, e: dict[str, Array], ends: Array) -> Score:
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
    return compiling.bounded(begun, (0, 2, 3)), compiling.bounded(run, 0)
