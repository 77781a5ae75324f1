"""Compiled programs of exact moments and calls of them: `FEW`, `SOME` or `MANY` cells side by side.

A batch of cells from tick 0 to its end: the compiled program of exact moments.

The loop is that of `engine.event_loop`: at an event samples are taken and packets arrive, then plant and observers flow to the
next (`propagate`). What goes along is the run without noise, a run with noise (`exactness`), the effect of each random number
of the start, and the covariance of the effects of all other noise. The start may be much larger than the errors that it leaves,
and goes by itself: a difference of effects on the state and on the estimate keeps its digits, one of their squares does not. A
tick's matrix is the same at every tick, or found where it changes, or looked at tick by tick: it is taken anew only where one
product with it differs from the last tick's.
"""

from collections.abc import Hashable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.engine import runner
from pcbench.moments import error_sums as sums_of
from pcbench.moments import final_tick
from pcbench.moments.error_sums import Seen
from pcbench.moments.events import Means, Moving, happen, sense, taken
from pcbench.moments.inputs import SCALES, Given, begin, own_of, together
from pcbench.moments.merging import mix_of
from pcbench.moments.noise_state import WRITTEN_OUT, form_of, over_cells, slope, steady, timed, vector
from pcbench.moments.propagate import Ways, along, recorded, rows, ways
from pcbench.moments.realisations import Realised
from pcbench.moments.tick_matrix import Tick, flat, matrix_of, next_change, one_cell
from pcbench.moments.types import Carried, Found, Shape
from pcbench.runtime import program_cache
from pcbench.simulation.schedule import common_times
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


FEW, SOME, MANY = 8, 64, 128  # cells a call; of the cart's a cell costs four fifths with 128 of what it does with 64


def compute(ones: list[Realised], recorded: str, every: int = 1, width: int | None = None) -> Found:
    """Return what a batch leaves, [..., FEW, SOME or MANY], with what is recorded at every so many ticks.

    `width` is how many the call is for; None: as few as have room for the batch.
    """
    own, width = own_of(ones[0].problem), width or width_of(ones, set())
    each = _alike([ones[min(i, len(ones) - 1)] for i in range(width)])
    given = together([one.problem for one in each], [one.network for one in each], [one.chance for one in each])
    if ones[0].mode:
        given = given._replace(mix=mix_of([one.mode for one in each]))
    made = _program(each[0], own, width, recorded, every, given)
    return jax.tree.map(np.asarray, made(given))


def width_of(ones: list[Realised], wide: set[Hashable]) -> int:
    """Return how many cells a call for these is for: of a kind that is `wide` already, the last ones go by its program."""
    kind = ones[0].layout, own_of(ones[0].problem)
    if len(ones) <= FEW:
        return FEW
    if len(ones) <= SOME and kind not in wide:
        return SOME
    wide.add(kind)
    return MANY


def _alike(each: list[Realised]) -> list[Realised]:
    """Give the schedules of some cells one shape."""
    slots = max(one.problem.schedule.arrive.shape[1] for one in each)
    early = max(len(one.problem.schedule.early) for one in each)
    notes = max(one.problem.schedule.also.shape[1] for one in each)
    wide = [common_times.pad_early(common_times.pad_slots(one.problem.schedule, slots), early) for one in each]
    wide = [common_times.pad_notes(one, notes) for one in wide]
    return [one._replace(problem=one.problem._replace(schedule=s)) for one, s in zip(each, wide, strict=True)]


def _program(one: Realised, own: tuple[bool, ...], width: int, recorded: str, every: int, given: Given) -> Any:
    leaves, tree = jax.tree.flatten(given)
    key = one.layout, own, width, recorded, every, tree, tuple((np.shape(a), np.asarray(a).dtype) for a in leaves)

    def new() -> Any:
        form = form_of(one.layout, one.problem)
        written = width > FEW and not form.flight and form.many <= WRITTEN_OUT
        return _compiled(one.layout, Shape(width, form, own, recorded, every, written), given)

    return _MADE.ask(key, new)


def _compiled(layout: Layout, shape: Shape, given: Given) -> Any:
    """A program for arrays of the shapes of `given`."""
    device = jax.devices()[0]
    options = runner.OPTIONS if device.platform == "cpu" else None
    placed = jax.sharding.SingleDeviceSharding(device)
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(np.shape(a), np.asarray(a).dtype, sharding=placed), given)

    def moments(given: Given) -> Found:
        return run(layout, shape, given)

    return jax.jit(moments).lower(shapes).compile(options)


_MADE = program_cache.Programs()
