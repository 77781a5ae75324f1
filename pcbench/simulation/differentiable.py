"""A block of runs whose metrics can be differentiated backwards: the rollout's own steps, tick by tick, in chunks.

`loop.simulate` goes from event to event in loops of unknown length, which reverse-mode differentiation cannot follow.
Here every tick is one step of a scan, and a scan over chunks keeps the state at their edges only: going back, a chunk is
computed again. So the memory of a gradient grows with the square root of the horizon, not with it.
"""

from math import isqrt
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes
from pcbench.simulation.closed_loop import decide
from pcbench.simulation.events_shared import Events, prepare
from pcbench.simulation.problem import Layout, Problem, State
from pcbench.simulation.steps import advance, errors, process_noise

SMOOTH = ("mae", "mse", "rmse", "peak")  # and each of them over the tail: what a gradient can be asked of


class Sums(NamedTuple):
    """What is kept of e of one observer's runs; n signals, L lanes."""

    absolute: Array  # [n, L] sum of |e|
    square: Array  # [n, L] sum of e^2
    peak: Array  # [n, L] max |e|


def metrics(layout: Layout, p: Problem, ticks: int, tail: int, root_seed: Array, seeds: Array) -> dict[str, Any]:
    """Return by observer label the smooth metrics of one run for each of seeds[L], [n, L], that the tables have.

    `ticks` is the horizon N, `tail` the tick at which the tail starts. All runs share one schedule. Where a run leaves all
    bounds, its metrics are not finite.
    """
    layout = layout._replace(watch=False)
    events, state = prepare(layout, p, root_seed, seeds)
    drawn = process_noise(p, root_seed, seeds)
    none = {label: _none(e) for label, e in _errors(layout, p, jnp.asarray(0), state).items()}

    def tick(carried: Any, k: Array) -> Any:
        state, whole, late = carried
        state = _happened(layout, p, events, k, state)
        e = _errors(layout, p, k, state)
        whole = {label: _added(whole[label], e[label]) for label in e}
        late = {label: _added(late[label], jnp.where(k >= tail, e[label], 0.0)) for label in e}
        moved = advance(layout, p, k, state, drawn(k))._replace(streams=state.streams, tracking=state.tracking)
        return lanes.like(moved, state, layout.width), whole, late

    @jax.checkpoint
    def chunk(carried: Any, first: Array) -> Any:
        def step(carried: Any, k: Array) -> Any:
            return lax.cond(k < ticks, tick, lambda c, k: c, carried, k), None

        return lax.scan(step, carried, first + jnp.arange(size))

    size = isqrt(ticks) + 1
    (_, whole, late), _ = lax.scan(chunk, (state, none, none), jnp.arange(0, ticks, size))
    return {label: _read(whole[label], ticks, "") | _read(late[label], ticks - tail, "tail_") for label in whole}


def _happened(layout: Layout, p: Problem, events: Events, k: Array, state: State) -> State:
    """The state after tick k's events and its command."""
    state = lax.cond(p.schedule.event[k], lambda s: events.happen(k, s)[0], lambda s: s, state)
    return lanes.like(decide(layout, p, k, state), state, layout.width)


def _errors(layout: Layout, p: Problem, k: Array, state: State) -> dict[str, Array]:
    return {label: lanes.whole(e, layout.width) for label, e in errors(layout, p, k, state).items()}


def _none(e: Array) -> Sums:
    return Sums(jnp.zeros_like(e), jnp.zeros_like(e), jnp.zeros_like(e))


def _added(sums: Sums, e: Array) -> Sums:
    size = jnp.abs(e)
    return Sums(sums.absolute + size, sums.square + e * e, jnp.maximum(sums.peak, size))


def _read(sums: Sums, count: int, prefix: str) -> dict[str, Array]:
    mse = sums.square / count
    still = mse > 0  # the root of 0 has no slope; an error that is 0 throughout has slope 0
    rmse = jnp.where(still, jnp.sqrt(jnp.where(still, mse, 1.0)), 0.0)
    values = {"mae": sums.absolute / count, "mse": mse, "rmse": rmse, "peak": sums.peak}
    return {prefix + name: value for name, value in values.items()}
