"""A batch of cells from tick 0 to its end: the compiled program of exact moments.

The loop is that of `simulation.loop`: at an event samples are taken and packets arrive, then plant and observers flow to the
next. What flows is a bundle: the run without noise, two runs with noise (`affine`), and the directions.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.moments import sums as sums_of
from pcbench.moments.bundle import Bundle, Carry, arrays, entries, floats, through
from pcbench.moments.carried import Carried, drawn, room
from pcbench.moments.events import Size, happen, launched
from pcbench.moments.forms import as_arrays, as_entries, like
from pcbench.moments.given import Given
from pcbench.moments.start import Start, begin
from pcbench.moments.sums import Seen
from pcbench.simulation import network, steps
from pcbench.simulation.closed_loop import held, off_target
from pcbench.simulation.problem import Layout, State

COVARIANCE = "covariance"
WRITTEN_OUT = 40  # numbers of a state; with more, a tick written out entry by entry takes too long to compile


class Shape(NamedTuple):
    """What is compiled in besides the layout."""

    size: Size
    own: tuple[bool, ...]  # which arrays of the problem are each cell's own
    recorded: str = ""  # nothing, "std" or COVARIANCE at every tick


class Recorded(NamedTuple):
    """Moments at every tick 0 .. N; Z signals of all observers, one after another."""

    mean: Array  # [N+1, Z, C]
    covariance: Array  # [N+1, Z, Z, C], or of each signal [N+1, Z, 1, C]


class Found(NamedTuple):
    """What a batch leaves."""

    sums: sums_of.Sums
    lost: Array  # [C]
    rows: Any  # Recorded; (): nothing is recorded


class Noise(NamedTuple):
    """What is drawn at every tick; numbers a tick."""

    process: int
    command: int  # where a decision is sent over a network


def run(layout: Layout, shape: Shape, given: Given) -> Found:
    """Return the moments of a batch of cells over ticks 0 .. N - 1, or recorded, 0 .. N."""
    size, layout, p = shape.size, layout._replace(width=1, watch=False), given.problem
    tail, end, q = p.windows[0, 1], p.windows[-1, 1], p.noise_std.shape[0]
    stop = end + 1 if shape.recorded else end
    noise = Noise(p.process_std.shape[0], p.network.std.shape[0] if layout.pending else 0)
    at_events = arrays(p, shape.own)
    carried = _begin(layout, shape, at_events, given)
    tick = partial(_tick, layout, shape, given, noise, (tail, end), at_events)

    def segment(at: tuple[Array, Carried]) -> tuple[Array, Carried]:
        k, c = at
        taken = given.plan.sense[k] >= 0
        c = room(c, jnp.where(taken, q, 0), q, size)
        own = drawn(given.noise[k, :q], c.used, size, taken)
        state, flight = happen(layout, at_events, given.plan, k, c.state, c.flight, own)
        c = c._replace(state=state, flight=flight, used=c.used + jnp.where(taken, q, 0))
        following = jnp.minimum(jnp.min(given.plan.next_event[k]), stop)
        return following, _flow(layout, shape, given, noise, tick, k, following, c)

    _, carried = lax.while_loop(lambda at: at[0] < stop, segment, (jnp.asarray(0), carried))
    return Found(carried.sums, carried.lost, carried.rows)


def _flow(
    layout: Layout, shape: Shape, given: Given, noise: Noise, tick: Any, start: Array, stop: Array, c: Carried
) -> Carried:
    """Let all cells flow to the next event of any: entry by entry where that is fastest."""
    if sum(noise) or sum(a.size for a in floats(c.state.mean)) > WRITTEN_OUT * shape.size.cells:
        return lax.fori_loop(start, stop, tick, c)
    state = as_entries(c.state, layout)
    carry = entries(given.problem, shape.own, like(state.mean, shape.size.cells))
    c = lax.fori_loop(start, stop, partial(tick, carry=carry), c._replace(state=state))
    return c._replace(state=as_arrays(c.state, shape.size.cells))


def _tick(
    layout: Layout,
    shape: Shape,
    given: Given,
    noise: Noise,
    window: tuple[Array, Array],
    at_events: Carry,
    k: Array,
    c: Carried,
    carry: Carry | None = None,
) -> Carried:
    """Estimate, control and flow: one tick of all cells, and what is kept of it."""
    size, (tail, end) = shape.size, window
    (process, command), late, more = noise, (), jnp.asarray(noise.process)
    if layout.pending:
        decision = k // given.problem.network.every
        decides = decision * given.problem.network.every == k
        late = tuple(each[decision] for each in given.network)
        more = process + jnp.where(decides, command, 0)
    c = room(c, jnp.broadcast_to(more, c.used.shape), sum(noise), size)
    own = given.noise[k, -sum(noise) :] if sum(noise) else jnp.zeros(0)
    each = drawn(own[:process], c.used, size), drawn(own[process:], c.used + process, size, more > process)
    entering = Bundle(*zip(*each, strict=True))
    if carry:  # entry by entry: nothing is drawn there
        entering = Bundle(jax.tree.map(lambda a: a[..., 0], entering.runs), entering.directions)
    found = through(partial(_one, layout), carry or at_events, k, c.state, entering, late)
    state, seen = (Bundle(*(part[i] for part in found)) for i in (0, 1))
    if carry:
        seen = as_arrays(seen, size.cells)
    weight = jnp.stack([k < end, (k < end) & (k >= tail)]) * 1.0
    return c._replace(
        state=state,
        used=c.used + more,
        sums=sums_of.added(c.sums, seen, weight, given, size),
        rows=_record(c.rows, k, seen, size) if shape.recorded else (),
    )


def _one(layout: Layout, p: Any, k: Array, state: State, noise: Any, late: Any) -> tuple[State, Seen]:
    """One tick of one cell: `steps.tick`, and what is read of it."""
    process, sent = noise
    p, loop, none = p._replace(weights=()), layout.controller, jnp.zeros(0)
    now = steps.Drawn(process, network.Drawn(late[0], late[1], sent) if layout.pending else ())

    def read(k: Array, state: State) -> Seen:
        return Seen(
            errors=jnp.concatenate([e for _, e in sorted(steps.errors(layout, p, k, state).items())]),
            off=off_target(loop, p, k, state.x) if loop else none,
            x=state.x if loop else none,
            u=held(p, k, state) if loop else none,
        )

    return steps.tick(layout, p, k, state, now, read=read)


def _begin(layout: Layout, shape: Shape, carry: Carry, given: Given) -> Carried:
    """Everything before tick 0; packets taken before it have measured the start."""
    size, zero, p = shape.size, jnp.asarray(0), given.problem
    n, q, none = p.x0.shape[0], p.noise_std.shape[0], jnp.zeros(size.cells, int)
    x, xhat = n * layout.random_start, n * layout.scattered
    starts = drawn(given.start[0], none, size, x > 0), drawn(given.start[1], none + x, size, xhat > 0)
    entering = Bundle(*(Start(*each) for each in zip(*starts, strict=True)))
    state = through(partial(begin, layout), carry, zero, Bundle((), ()), entering)
    used, noises = none + x + xhat, []
    for place in range(given.plan.early.shape[0]):
        there = jnp.any(given.plan.early[place] >= 0, 0)
        noises.append(drawn(given.noise[-1 - place, :q], used, size, there))
        used = used + jnp.where(there, q, 0)
    silent = Bundle(*(jnp.zeros((lead, q, size.cells)) for lead in size.lead))
    flight = launched(layout, carry, given.plan, state, silent, noises)
    found = carry.over(lambda p, k, state: steps.estimates(layout, p, state))(zero, state.mean)
    signals, loop = sum(len(each) for each in found.values()), layout.controller
    targets = len(loop.target(p.control, zero)) if loop else None
    rows = _rows(shape, signals, given)
    return Carried(state, flight, used, jnp.zeros(size.cells), sums_of.nothing(signals, targets, size.cells), rows)


def _rows(shape: Shape, signals: int, given: Given) -> Any:
    """Room for the moments of every tick, where they are recorded."""
    if not shape.recorded:
        return ()
    ticks, cells = given.plan.sense.shape
    others = signals if shape.recorded == COVARIANCE else 1
    return Recorded(jnp.zeros((ticks, signals, cells)), jnp.zeros((ticks, signals, others, cells)))


def _record(rows: Recorded, k: Array, seen: Bundle, size: Size) -> Recorded:
    """Write down the moments of tick k."""
    mean, along = sums_of.moments(seen, "errors", size)
    if rows.covariance.shape[2] == 1:
        covariance = jnp.sum(along**2, 0)[:, None]
    else:
        covariance = jnp.einsum("ric,rjc->ijc", along, along)
    write = lax.dynamic_update_index_in_dim
    return Recorded(write(rows.mean, mean, k, 0), write(rows.covariance, covariance, k, 0))
