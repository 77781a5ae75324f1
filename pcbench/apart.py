"""Many runs on schedules of their own: every lane is at a tick of its own, and lanes meet to jump together.

With random sampling some lane has an event at nearly every tick, and to ask all lanes each time costs ten times the flow. So a
lane flows by itself until its next event and waits there; every `stride` ticks all lanes that wait do what they wait for, in
one step. Time is no lane's business but its own: the input is read at the lane's own tick, and every run has the numbers it has
alone on its own schedule (`rollout.simulate`), whatever the others do.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench import draws, irregular, lanes
from pcbench.irregular import Agenda
from pcbench.lanes import Lanes
from pcbench.rollout import Layout, Outcome, Problem, Row, State, advance, begin, errors, hand_over, measure, note


class Course(NamedTuple):
    """Where every lane is. All whole numbers [L]; rings have a leading axis of places."""

    k: Array  # its tick
    stop: Array  # the tick at which it waits
    sensed: Array  # how many samples it has taken,
    noted: Array  # noted,
    arrived: Array  # and been handed
    latest: Array  # the last tick at which anything arrived, and
    earlier: Array  # the last such tick before that
    window: Array  # which window it is in
    state: State  # `flight`: rings of values and of notes
    saved: Any  # [W] the streams of the windows it has left
    final: Any  # the error at tick N-1


def simulate(layout: Layout, p: Problem, root_seed: Array, seeds: Array) -> Outcome:
    """Simulate one lane for each of seeds[L] on its own schedule over all windows; L must be `layout.width`."""
    plan = irregular.agenda(p.schedule, root_seed, seeds)
    noise = _noise(p, root_seed, seeds)
    many = p.windows.shape[0]

    def meet(c: Course) -> Course:
        return _wait(p, plan, _leave(layout, p, _deliver(layout, p, plan, _sense(layout, p, plan, noise, c))))

    def flow(c: Course) -> Course:
        return lax.fori_loop(0, p.schedule.stride, lambda _, c: _tick(layout, p, c), c)

    start = _wait(p, plan, _start(layout, p, plan, root_seed, seeds))
    c = lax.while_loop(lambda c: (c.window < many).any(), lambda c: flow(meet(c)), start)
    streams, watches, final = jax.tree.map(
        lambda a: lanes.whole(a, layout.width), (c.saved, c.state.watches, c.final), is_leaf=lanes.is_lanes
    )
    return Outcome(streams, watches, final)


def _noise(p: Problem, root_seed: Array, seeds: Array) -> Array:
    """Standard normal noise of every sample, [q, M, L]: the same draws as on a shared schedule."""
    keys = draws.run_keys(root_seed, seeds, "measurement", p.noise_std.shape[0])
    index = jnp.arange(p.schedule.due.shape[1])
    return jnp.stack([lax.map(lambda i, key=key: draws.normals([key], i[None])[0], index) for key in keys])


def _start(layout: Layout, p: Problem, plan: Agenda, root_seed: Array, seeds: Array) -> Course:
    state = begin(layout, p, root_seed, seeds)
    zero = jnp.zeros(layout.width, int)
    rings = jax.tree.map(lambda v: jnp.broadcast_to(v, (layout.ring, *v.shape)), state.flight)
    saved = jax.tree.map(lambda v: jnp.zeros((p.windows.shape[0], *v.shape)), state.streams)
    before = (plan.taken - p.schedule.error < 0).sum(0)  # believed to be from before tick 0: the start is noted
    first = errors(layout, p, state)
    return Course(zero, zero, zero, before, zero, zero, zero, zero, state._replace(flight=rings), saved, first)


def _tick(layout: Layout, p: Problem, c: Course) -> Course:
    """Advance every lane that is not waiting by one tick."""
    going = c.k < c.stop
    moved = advance(layout, p, _scalar(c.k), c.state._replace(flight=None))._replace(flight=c.state.flight)
    return c._replace(k=c.k + going, state=_choose(going, moved, c.state))


def _sense(layout: Layout, p: Problem, plan: Agenda, noise: Array, c: Course) -> Course:
    """Take the sample, and note for the sample, that are due at the lane's tick."""
    due, noting = _at(plan.taken, c.sensed) == c.k, _at(plan.taken, c.noted) - p.schedule.error == c.k
    number = _at(plan.number, c.sensed)
    v = lanes.split(jnp.stack([_at(each, number) for each in noise]))
    y = measure(layout, p, _scalar(c.k), c.state.x, v)
    notes = note(layout, p, _scalar(c.k), c.state.memories)
    flight = (_put(c.state.flight[0], c.sensed, y, due), _put(c.state.flight[1], c.noted, notes, noting))
    return c._replace(sensed=c.sensed + due, noted=c.noted + noting, state=c.state._replace(flight=flight))


def _deliver(layout: Layout, p: Problem, plan: Agenda, c: Course) -> Course:
    """Hand over the oldest packet that arrives at the lane's tick, once all that is taken at that tick is taken."""
    more = (_at(plan.taken, c.sensed) == c.k) | (_at(plan.taken, c.noted) - p.schedule.error == c.k)
    comes = (_at(plan.arrives, c.arrived) == c.k) & ~more
    which = _at(plan.rank, c.arrived)
    packet = jax.tree.map(lambda ring: _at(ring, which % layout.ring), c.state.flight)
    age = c.k - jnp.maximum(_at(plan.taken, which) - p.schedule.error, 0)
    clock, number = _at(plan.clock, which), _at(plan.number, which)
    again = c.latest == c.k
    since = c.k - jnp.where(again, c.earlier, c.latest)
    channels = range(p.noise_std.shape[0])
    row = Row(
        lanes.split(jnp.stack([clock == p.schedule.clock_of[j] for j in channels])),
        lanes.split(jnp.stack([age for _ in channels])),
        lanes.split(jnp.stack([number for _ in channels])),
        _scalar(since),
    )
    jumped = hand_over(layout, p, _scalar(c.k), row, packet, c.state.memories)
    return c._replace(
        arrived=c.arrived + comes,
        earlier=jnp.where(comes & ~again, c.latest, c.earlier),
        latest=jnp.where(comes, c.k, c.latest),
        state=c.state._replace(memories=_choose(comes, jumped, c.state.memories)),
    )


def _leave(layout: Layout, p: Problem, c: Course) -> Course:
    """Where a lane stands at its window's end, put the window's streams by and start the next one's; read the last error."""
    ends = p.windows[:, 1]
    leaving = (c.window < len(ends)) & (c.k == ends[jnp.minimum(c.window, len(ends) - 1)])
    saved = _put(c.saved, c.window, c.state.streams, leaving)
    fresh = jax.tree.map(jnp.zeros_like, c.state.streams)
    state = c.state._replace(streams=_choose(leaving, fresh, c.state.streams))
    final = _choose(c.k == p.windows[-1, 0], errors(layout, p, c.state), c.final)
    return c._replace(window=c.window + leaving, state=state, saved=saved, final=final)


def _wait(p: Problem, plan: Agenda, c: Course) -> Course:
    """Say where each lane waits next: at a sample, a note, an arrival or a window's end."""
    ends = p.windows[:, 1]
    edge = ends[jnp.minimum(c.window, len(ends) - 1)]
    events = _at(plan.taken, c.sensed), _at(plan.taken, c.noted) - p.schedule.error, _at(plan.arrives, c.arrived)
    stop = jnp.minimum(jnp.minimum(events[0], events[1]), jnp.minimum(events[2], edge))
    return c._replace(stop=stop)


def _scalar(x: Array) -> Lanes:
    """A whole number of each lane [L] as one-lane code sees it."""
    return lanes.split(x)


def _at(table: Array, place: Array) -> Array:
    """Each lane's entry of a table [E, L]; what is of size 0 stays."""
    return jnp.take_along_axis(table, place[None], 0)[0] if table.ndim > 1 and table.size else table


def _put(rings: Any, place: Array, new: Any, when: Array) -> Any:
    """Write each lane's `new` to its place in rings [R, L], where `when`; a place counts round."""

    def one(ring: Array, v: Array) -> Array:
        if not v.size:
            return ring
        here = (jnp.arange(ring.shape[0])[:, None] == place % ring.shape[0]) & when
        return jnp.where(here, v, ring)

    return jax.tree.map(one, rings, new)


def _choose(when: Array, new: Any, old: Any) -> Any:
    """Take `new` in the lanes where `when`; what is of size 0 stays."""
    new = lanes.like(new, old, when.shape[0])
    return jax.tree.map(lambda a, b: jnp.where(when, a, b) if b.size else b, new, old)
