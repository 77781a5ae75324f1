"""A block of runs whose metrics can be differentiated backwards: the same steps, tick by tick, in chunks.

`loop.simulate` goes from event to event in loops of unknown length, which reverse-mode differentiation cannot follow.
Here every tick is one step of a scan, and a scan over chunks keeps the state at their edges only: going back, a chunk is
computed again. So the memory of a gradient grows with the square root of the horizon, not with it.
"""

from functools import partial
from math import isqrt
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes, steps
from pcbench.simulation import metrics as sums
from pcbench.simulation.events_shared import prepare, where_any
from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.metrics import Stream
from pcbench.simulation.problem import Layout, Problem, State
from pcbench.simulation.start import drawing

SMOOTH = ("mae", "mse", "rmse", "peak")  # and each of them over the tail: what a gradient can be asked of
Streams = dict[str, Stream]


def metrics(layout: Layout, p: Problem, ticks: int, tail: int, root_seed: Array, seeds: Array) -> dict[str, Any]:
    """Return by observer label the smooth metrics of one run for each of seeds[L], [n, L], that the tables have.

    `ticks` is the horizon N, `tail` the tick at which the tail starts. All runs share one schedule. Where a run leaves all
    bounds, its metrics are not finite.
    """
    layout = layout._replace(watch=False)
    events, state = prepare(layout, p, root_seed, seeds)
    happen, drawn = where_any(p, events), drawing(layout, p, root_seed, seeds)

    def tick(carried: tuple[State, Streams], k: Array) -> tuple[State, Streams]:
        state, late = carried
        new, e = steps.tick(layout, p, k, state, drawn(k), happen, partial(steps.errors, layout, p))
        later = over(lambda k, late, e: {o: sums.update(late[o], jnp.where(k >= tail, e[o], 0.0)) for o in e})
        return lanes.like(new, state, layout.width), lanes.like(later(k, late, e), late, layout.width)

    @jax.checkpoint
    def chunk(carried: tuple[State, Streams], first: Array) -> Any:
        def step(carried: tuple[State, Streams], k: Array) -> Any:
            return lax.cond(k < ticks, tick, lambda c, k: c, carried, k), None

        return lax.scan(step, carried, first + jnp.arange(size))

    size = isqrt(ticks) + 1
    (end, late), _ = lax.scan(chunk, (state, state.streams), jnp.arange(0, ticks, size))
    whole, late = jax.tree.map(lambda a: lanes.whole(a, layout.width), (end.streams, late), is_leaf=lanes.is_lanes)
    return {label: _read(whole[label], ticks, "") | _read(late[label], ticks - tail, "tail_") for label in whole}


def _read(stream: Stream, count: int, prefix: str) -> dict[str, Array]:
    mse = stream.square / count
    still = mse > 0  # the root of 0 has no slope; an error that is 0 throughout has slope 0
    rmse = jnp.where(still, jnp.sqrt(jnp.where(still, mse, 1.0)), 0.0)
    values = {"mae": stream.absolute / count, "mse": mse, "rmse": rmse, "peak": stream.peak}
    return {prefix + name: value for name, value in values.items()}
