"""One run with everything in sight, recorded at every tick 0 .. N.

Slower than `loop.simulate`, which keeps sums only; the same functions in the same order (`steps.tick`).
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.simulation import compiling, lanes
from pcbench.simulation.closed_loop import aims, held
from pcbench.simulation.consistency import sigmas, squares
from pcbench.simulation.events_shared import Shift, prepare, where_any
from pcbench.simulation.problem import Layout, PerLane, Problem, State
from pcbench.simulation.start import drawing
from pcbench.simulation.steps import actual, errors, estimates, tick


class Recording(NamedTuple):
    """Every tick 0 .. N of one run."""

    x: Array  # [N+1, n + s] the state, and what the plant has of unknowns
    estimates: dict[str, Array]  # [N+1, n or n + s], after the jump of each tick
    u: Array  # [N+1, m] the input held over the tick
    arrived: Array  # [N+1, q] what arrived at this tick, the newest of each channel; NaN where nothing did
    brought: Array  # [N+1, S, q] what each of the packets that arrived brought, NaN where nothing
    target: Array  # [N+1, r] the set point of a closed loop
    sigma: dict[
        str, Array
    ]  # [N+1, n or n + s] standard deviations that observers believe, of a layout with consistency


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
            arrived=_newest(brought := _brought(layout, p, k, state))[:, 0],
            brought=brought[..., 0],
            target=aims(layout, p, k),
            sigma={label: _whole(each) for label, each in sigmas(layout, p, k, state).items()}
            if layout.consistency
            else {},
        )

    def step(state: State, k: Array) -> tuple[State, Recording]:
        new, row = tick(layout, p, k, state, drawn(k), happen, read)
        return lanes.like(new, state, 1), row

    _, out = lax.scan(step, state, jnp.arange(p.schedule.event.shape[0]))
    return out


def _believed(layout: Layout, p: Problem, k: Array, state: State, many: int) -> dict[str, Any]:
    """What observers believe of their errors at tick k, and how wrong they are."""
    if not layout.consistency:
        return {"sigma": {}, "nees": {}}
    found = squares(layout, p, k, state, errors(layout, p, k, state))
    return {
        "sigma": {o: lanes.whole(each, many) for o, each in sigmas(layout, p, k, state).items()},
        "nees": {o: (lanes.whole(each.whole, many), lanes.whole(each.states, many)) for o, each in found.items()},
    }


def _brought(layout: Layout, p: Problem, k: Array, state: State) -> Array:
    """What each packet brings that arrives at tick k: [S, q, L], NaN where nothing."""
    plan, out = p.schedule, []
    for slot in range(plan.arrive.shape[1]):
        row = plan.arrive[k, slot] % layout.ring
        value = lanes.whole(jax.tree.map(lambda ring, row=row: ring[row], state.flight.values), layout.width)
        out.append(jnp.where(plan.fresh[k, slot][:, None], value, jnp.nan))
    return jnp.stack(out)


def _newest(brought: Array) -> Array:
    """What arrives at a tick, the newest of each channel: [q, L], NaN where nothing does."""
    y = brought[0]
    for value in brought[1:]:
        y = jnp.where(jnp.isnan(value), y, value)
    return y


def _whole(a: PerLane) -> Array:
    return lanes.whole(a, 1)[:, 0]


@cache
def compiled() -> Any:
    """Return `record` compiled, once for each shape in a process."""
    return compiling.bounded(record, 0)


class Thinned(NamedTuple):
    """Every so many ticks of L runs on one schedule: K rows."""

    x: Array  # [K, n + s, L]
    estimates: dict[str, Array]  # [K, n or n + s, L]
    held: Array  # [K, q, L] what has arrived and is held; NaN before
    target: Array  # [K, r] the set point of a closed loop
    sigma: dict[
        str, Array
    ]  # [K, n or n + s, L] standard deviations that observers believe, of a layout with consistency
    nees: dict[str, tuple[Array, Array]]  # [K, L] e' P^-1 e over n, and the n; of a layout with consistency


def record_some(layout: Layout, every: int, rows: int, p: Problem, root_seed: Array, seeds: Array) -> Thinned:
    """Record ticks 0, every, 2 every ... of the runs seeds[L], so many rows; their schedule is one for all."""
    many = seeds.shape[0]
    layout = layout._replace(width=many)
    events, state = prepare(layout, p, root_seed, seeds)
    happen, drawn = where_any(p, events), drawing(layout, p, root_seed, seeds)
    none = jnp.full((*p.noise_std.shape, many), jnp.nan)

    def read(k: Array, state: State) -> Thinned:
        return Thinned(
            x=lanes.whole(actual(layout, p, k, state), many),
            estimates={o: lanes.whole(xhat, many) for o, xhat in estimates(layout, p, state).items()},
            held=_newest(_brought(layout, p, k, state)),
            target=aims(layout, p, k),
            **_believed(layout, p, k, state, many),
        )

    def step(carry: tuple[State, Array, Thinned], k: Array) -> tuple[tuple[State, Array, Thinned], None]:
        state, held, table = carry
        new, row = tick(layout, p, k, state, drawn(k), happen, read)
        row = row._replace(held=jnp.where(jnp.isnan(row.held), held, row.held))
        place = jnp.where(k % every == 0, k // every, rows)  # the last row takes what is not kept
        table = jax.tree.map(lambda a, v: lax.dynamic_update_index_in_dim(a, v.astype(a.dtype), place, 0), table, row)
        return (lanes.like(new, state, many), row.held, table), None

    ticks = jnp.arange(every * (rows - 1) + 1)
    shape = jax.eval_shape(lambda: read(ticks[0], state))
    table = jax.tree.map(lambda a: jnp.zeros((rows + 1, *a.shape), a.dtype), shape)
    return jax.tree.map(lambda a: a[:rows], lax.scan(step, (state, none, table), ticks)[0][2])


@cache
def compiled_some() -> Any:
    """Return `record_some` compiled, once for each shape in a process."""
    return compiling.bounded(record_some, (0, 1, 2))
