"""One run with everything in sight, recorded at every tick 0 .. N.

Slower than `loop.simulate`, which keeps sums only; the same functions in the same order (`steps.tick`).
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import lanes
from pcbench.simulation.closed_loop import aims, held
from pcbench.simulation.events_shared import Shift, prepare, where_any
from pcbench.simulation.problem import Layout, PerLane, Problem, State
from pcbench.simulation.start import drawing
from pcbench.simulation.steps import actual, estimates, tick


class Recording(NamedTuple):
    """Every tick 0 .. N of one run."""

    x: Array  # [N+1, n + s] the state, and what the plant has of unknowns
    estimates: dict[str, Array]  # [N+1, n or n + s], after the jump of each tick
    u: Array  # [N+1, m] the input held over the tick
    arrived: Array  # [N+1, q] what arrived at this tick, NaN where nothing did
    target: Array  # [N+1, r] the set point of a closed loop


def record(layout: Layout, p: Problem, root_seed: Array, seed: Array, shift: Shift | None = None) -> Recording:
    """Record one run tick by tick, tick N included; with a `shift`, on packets that are changed by it."""
    layout = layout._replace(width=1)
    events, state = prepare(layout, p, root_seed, seed[None], shift)
    happen, drawn = where_any(p, events), drawing(layout, p, root_seed, seed[None])

    def read(k: Array, state: State) -> Recording:
        return Recording(
            x=_whole(actual(layout, p, k, state)),
            estimates={label: _whole(xhat) for label, xhat in estimates(layout, p, state).items()},
            u=_whole(held(p, k, state)),
            arrived=_arrived(layout, p, k, state),
            target=aims(layout, p, k),
        )

    def step(state: State, k: Array) -> tuple[State, Recording]:
        new, row = tick(layout, p, k, state, drawn(k), happen, read)
        return lanes.like(new, state, 1), row

    _, out = lax.scan(step, state, jnp.arange(p.schedule.event.shape[0]))
    return out


def _arrived(layout: Layout, p: Problem, k: Array, state: State) -> Array:
    """What arrives at tick k, the newest of each channel: [q], NaN where nothing does."""
    plan, y = p.schedule, jnp.full(p.noise_std.shape, jnp.nan)
    for slot in range(plan.arrive.shape[1]):
        row = plan.arrive[k, slot] % layout.ring
        value = _whole(jax.tree.map(lambda ring, row=row: ring[row], state.flight.values))
        y = jnp.where(plan.fresh[k, slot], value, y)
    return y


def _whole(a: PerLane) -> Array:
    return lanes.whole(a, 1)[:, 0]


@cache
def compiled() -> Any:
    """Return `record` compiled, once for each shape in a process."""
    return jax.jit(record, static_argnums=0)
