"""One run, tick by tick, with everything in sight: the rollout's own steps, recorded at every tick 0 .. N.

Slower than `loop.simulate`, which keeps sums only; the same functions in the same order.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes
from pcbench.simulation.closed_loop import aims, decide, held
from pcbench.simulation.events_shared import prepare
from pcbench.simulation.problem import Layout, Problem, State
from pcbench.simulation.steps import actual, advance, estimates, process_noise


class Recording(NamedTuple):
    """Every tick 0 .. N of one run."""

    x: Array  # [N+1, n + s] the state, and what the plant has of unknowns
    estimates: dict[str, Array]  # [N+1, n or n + s], after the jump of each tick
    u: Array  # [N+1, m] the input held over the tick
    arrived: Array  # [N+1, q] what arrived at this tick, NaN where nothing did
    target: Array  # [N+1, r] the set point of a closed loop


def record(layout: Layout, p: Problem, root_seed: Array, seed: Array) -> Recording:
    """Record one run tick by tick, tick N included."""
    layout = layout._replace(width=1)
    events, state = prepare(layout, p, root_seed, seed[None])
    drawn = process_noise(p, root_seed, seed[None])

    def whole(a: Any) -> Array:
        return lanes.whole(a, 1)[:, 0]

    def arrivals(k: Array, rings: Any) -> Array:
        y = jnp.full(p.noise_std.shape, jnp.nan)
        for slot in range(p.schedule.arrive.shape[1]):
            place = p.schedule.arrive[k, slot] % layout.ring
            value = whole(jax.tree.map(lambda ring, place=place: ring[place], rings))
            y = jnp.where(p.schedule.fresh[k, slot], value, y)
        return y

    def tick(state: State, k: Array) -> tuple[State, Recording]:
        state = lax.cond(p.schedule.event[k], lambda s: events.happen(k, s)[0], lambda s: s, state)
        state = lanes.like(decide(layout, p, k, state), state, 1)
        shown = {label: whole(xhat) for label, xhat in estimates(layout, p, state).items()}
        u, y = whole(held(layout, p, k, state)), arrivals(k, state.flight[0])
        row = Recording(whole(actual(layout, p, k, state)), shown, u, y, aims(layout, p, k))
        return lanes.like(advance(layout, p, k, state, drawn(k)), state, 1), row

    _, out = lax.scan(tick, state, jnp.arange(p.schedule.event.shape[0]))
    return out


@cache
def compiled() -> Any:
    """Return `record` compiled, once for each shape in a process."""
    return jax.jit(record, static_argnums=0)
