"""A batch of cells from tick 0 to its end: the compiled program of exact moments.

The loop is that of `engine.event_loop`: at an event samples are taken and packets arrive, then plant and observers flow to the
next (`propagate`). What goes along is the run without noise, a run with noise (`exactness`), the effect of each random number
of the start, and the covariance of the effects of all other noise. The start may be much larger than the errors that it leaves,
and goes by itself: a difference of effects on the state and on the estimate keeps its digits, one of their squares does not. A
tick's matrix is the same at every tick, or found where it changes, or looked at tick by tick: it is taken anew only where one
product with it differs from the last tick's.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from pcbench.moments import error_sums as sums_of
from pcbench.moments import final_tick
from pcbench.moments.error_sums import Seen
from pcbench.moments.events import Means, Moving, happen, sense, taken
from pcbench.moments.initial_moments import begin
from pcbench.moments.inputs import SCALES, Given
from pcbench.moments.noise_state import over_cells, slope, steady, timed, vector
from pcbench.moments.propagate import Ways, along, recorded, rows, ways
from pcbench.moments.tick_matrix import Tick, flat, matrix_of, next_change, one_cell
from pcbench.moments.types import Carried, Found, Shape
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import Layout


def run(layout: Layout, shape: Shape, given: Given) -> Found:
    """Return the moments of a batch of cells over ticks 0 .. N - 1, or recorded, 0 .. N."""
    layout, p = layout._replace(width=1, watch=False), given.problem
    end = p.windows[-1, 1]
    stop = end + 1 if shape.recorded else end
    std = jnp.broadcast_to(
        p.noise_std if p.noise_std.ndim == 2 else p.noise_std[:, None], (len(p.noise_std), shape.cells)
    )
    by = Means(
        layout=layout,
        form=shape.form,
        over=over_cells(p, shape.own, shape.cells, shape.written),
        std=std,
        chance=given.chance,
        mix=given.mix,
    )
    before, go = _begin(by, shape, given)

    def segment(at: tuple[Array, Carried]) -> tuple[Array, Carried]:
        number, c = at
        k, now = given.plan.at[number], jax.tree.map(lambda a: a[number], given.plan.events)
        c = c._replace(moving=happen(by, k, now, c.moving, given.arrivals[k]))
        return number + 1, along(go, k, jnp.minimum(given.plan.at[number + 1], stop), c)

    _, carried = lax.while_loop(lambda at: given.plan.at[at[0]] < stop, segment, (jnp.asarray(0), before))
    moving = carried.moving
    return Found(carried.sums, recorded(go, carried.rows), carried.last, moving.unlike, _reached(by, moving))


def _reached(by: Means, m: Moving) -> Array:
    """How large the state is in the end, as `Found` has it; it is the first of what noise reaches."""
    size = jnp.max(jnp.abs(m.runs.x), 0)
    variance = jnp.einsum("ddc->dc", m.P)[: len(size)] if by.form.moving[0] else jnp.zeros_like(size)
    return jnp.stack([size, jnp.sqrt(jnp.maximum(variance, 0.0))])


def _begin(by: Means, shape: Shape, given: Given) -> tuple[Carried, Ways]:
    """Everything before tick 0; packets taken before it have measured the start."""
    cells, zero, p, form, layout = shape.cells, jnp.asarray(0), given.problem, by.form, by.layout
    n, q, many = p.x0.shape[0], by.std.shape[0], len(SCALES)
    drawn = jnp.broadcast_to(given.start[:, :, None], (many, 2 * n, cells))
    start = partial(begin, layout)
    entering = jnp.concatenate([jnp.zeros_like(drawn[:1]), drawn])
    runs = jax.vmap(lambda e: by.over(start)(zero, (), e, ()))(entering)

    def made(p: Any, k: Array, state: Any, e: Array, rest: Any) -> Array:
        return jax.jacfwd(lambda e: vector(form, start(p, k, (), e, ())))(e)

    B = by.over(made)(zero, (), entering[0], ())
    mean = jax.tree.map(lambda a: a[0], runs)
    first = by.over(partial(sense, layout))(zero, mean, jnp.zeros((0, cells)), ())
    places, f, A = layout.ring + 1, first.shape[0], B.shape[0]
    D = A + places * f * form.flight
    flight = jnp.zeros((1 + many, places, f, cells))
    random = [at for at in range(2 * n) if (layout.random_initial_state if at < n else layout.scattered)]
    shifts = jnp.concatenate([jnp.sum(B[None] * drawn[:, None], 2), jnp.moveaxis(B[:, random], 1, 0)])
    apart = jnp.zeros((len(shifts), D, cells)).at[:, :A].set(shifts)
    unlike = jnp.zeros(cells) if by.mix else ()
    m = Moving(runs, flight, jnp.zeros((D, D, cells)), apart, unlike)
    m = taken(by, zero, m, jnp.broadcast_to((jnp.arange(f) >= q)[None, :, None], (places, f, cells)))
    for place in range(given.plan.early.shape[0]):
        there = jnp.any(given.plan.early[place] >= 0, 0)
        here = (jnp.arange(places)[:, None] == place) & (jnp.arange(f) < q)[None]
        m = taken(by, zero, m, here[:, :, None] & there[None, None])
    late = tuple(each[0] for each in given.network) if layout.pending else ()
    shown, seen = _shapes(by, given, runs, late)
    none = jnp.zeros((given.ticks.shape[2], cells))
    one = slope(form, partial(one_cell, layout), partial(flat, form))
    changes = None
    if steady(p, shape.own, one, mean, none, late):
        tick = Tick(matrix_of(by)(zero, mean, none, late), ())
    elif not late and timed(p, shape.own, one, mean, none, late):
        tick, changes = Tick(matrix_of(by)(zero, mean, none, late), ()), next_change(by, runs, len(given.ticks), none)
    else:
        tick = Tick(jnp.zeros((A + shown, A + len(none), cells)), jnp.full((A + shown, cells), jnp.nan))
    targets = seen.off.shape[0] if layout.controller else None
    go = ways(by, shape, given, tick, seen, changes, len(shifts))
    kept = sums_of.nothing(len(seen.errors), targets, cells), rows(go, len(seen.errors))
    last = final_tick.nothing(by, mean, len(seen.errors)) if layout.consistency else ()
    return Carried(m, tick, *kept, last), go


def _shapes(by: Means, given: Given, runs: Run, late: Any) -> tuple[int, Seen]:
    """How many numbers are read at a tick, and their shapes."""
    none = jnp.zeros((given.ticks.shape[2], by.std.shape[1]))
    mean = jax.tree.map(lambda a: a[0], runs)
    _, seen = jax.eval_shape(lambda s: by.over(partial(one_cell, by.layout))(jnp.asarray(0), s, none, late), mean)
    return sum(len(each) for each in seen), seen
