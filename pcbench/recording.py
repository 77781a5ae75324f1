"""One run, tick by tick, with everything in sight: the rollout's own steps, recorded at every tick 0 .. N.

Slower than `simulation.simulate`, which keeps sums only; the same functions in the same order.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench import lanes
from pcbench.rollout import Layout, Problem, State, actual, advance, estimates, process_noise
from pcbench.shared_events import prepare


class Recording(NamedTuple):
    """Every tick 0 .. N of one run."""

    x: Array  # [N+1, n + s] the state, and what the plant has of unknowns
    estimates: dict[str, Array]  # [N+1, n or n + s], after the jump of each tick
    samples: Array  # [N+1, q] what was measured at this tick, NaN where nothing was


def record(layout: Layout, p: Problem, root_seed: Array, seed: Array) -> Recording:
    """Record one run tick by tick, tick N included."""
    layout = layout._replace(width=1)
    events, state = prepare(layout, p, root_seed, seed[None])
    drawn = process_noise(p, root_seed, seed[None])

    def tick(state: State, k: Array) -> tuple[State, Recording]:
        state = lax.cond(p.schedule.event[k], lambda s: events.happen(k, s)[0], lambda s: s, state)
        place = p.schedule.sense[k] % layout.ring
        values = jax.tree.map(lambda ring: ring[place], state.flight[0])
        value = lanes.whole(values, 1)[:, 0]
        y = jnp.where(p.schedule.sampled[k], value, jnp.nan)
        shown = {label: lanes.whole(xhat, 1)[:, 0] for label, xhat in estimates(layout, p, state).items()}
        row = Recording(lanes.whole(actual(layout, p, k, state), 1)[:, 0], shown, y)
        return lanes.like(advance(layout, p, k, state, drawn(k)), state, 1), row

    _, out = lax.scan(tick, state, jnp.arange(p.schedule.event.shape[0]))
    return out


@cache
def compiled() -> Any:
    """Return `record` compiled, once for each shape in a process."""
    return jax.jit(record, static_argnums=0)
