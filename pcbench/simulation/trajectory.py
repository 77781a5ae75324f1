"""Record all signals of runs at every tick 0 .. N, or at every m-th tick. The ticks are `simulate_runs.tick`."""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.runtime import program_cache
from pcbench.simulation import closed_loop, innovation_stats, measurements, simulate_runs
from pcbench.simulation.simulate_runs import Run, Shift
from pcbench.simulation.types import GridPointParams, Layout, params_of, present, truth


class Recording(NamedTuple):
    """Every tick 0 .. N of one run."""

    x: Array  # [N+1, n + s] the state and the plant's unknown inputs
    estimates: dict[str, Array]  # [N+1, n or n + s], after the jump of each tick
    u: Array  # [N+1, m] the input held over the tick
    newest: Array  # [N+1, q] the newest arrival of each channel at this tick; NaN: none
    arrivals: Array  # [N+1, S, q] the values of each packet that arrives; NaN: none
    target: Array  # [N+1, r] the set point of a closed loop
    sigma: dict[str, Array]  # [N+1, n or n + s] standard deviations that observers report, if consistency is on
    errors: dict[str, Array]  # [N+1, d] the plant's user-defined errors; empty: none
    bounds: dict[str, Array]  # [N+1, 2, n] interval ends of observers with bounds


class Trajectories(NamedTuple):
    """Every m-th tick of L runs on one schedule: K rows."""

    x: Array  # [K, n + s, L]
    estimates: dict[str, Array]  # [K, n or n + s, L]
    newest: Array  # [K, q, L] the last arrival of each channel; NaN before the first
    target: Array  # [K, r] the set point of a closed loop
    sigma: dict[str, Array]  # [K, n or n + s, L] standard deviations that observers report, if consistency is on
    nees: dict[str, tuple[Array, Array]]  # [K, L] e' P^-1 e over n, and the n; if consistency is on
    errors: dict[str, Array]  # [K, d, L] the plant's user-defined errors; empty: none
    bounds: dict[str, Array]  # [K, 2, n, L] interval ends of observers with bounds


def record(layout: Layout, p: GridPointParams, root_seed: Array, seed: Array, shift: Shift | None = None) -> Recording:
    """Record one run at every tick, tick N included; a `shift` changes its packets."""
    start, params, draws = _init_run(layout, p, root_seed, seed)

    def read(k: Array, run: Run) -> Recording:
        arrivals = _arrivals(layout, p, k, run)
        return Recording(
            x=truth(layout, params, present(p, k, True), run.x),
            estimates={label: o.estimate(p.gains[label], run.memories[label]) for label, o in layout.observers},
            u=closed_loop.add_command_noise(present(p, k, True, run.commands), run.commands).u,
            newest=_newest(arrivals),
            arrivals=arrivals,
            target=closed_loop.set_point_at(layout, p, k),
            sigma=sigma(layout, p, k, run),
            errors=simulate_runs.user_errors(layout, p, params, k, run),
            bounds=_bounds(layout, p, run),
        )

    ticks = jnp.arange(p.schedule.event.shape[0])
    step = partial(simulate_runs.tick, layout, p, params, draws, read=read, shift=shift)
    return lax.scan(step, start, ticks)[1]


def record_some(
    layout: Layout, interval: int, rows: int, p: GridPointParams, root_seed: Array, seeds: Array
) -> Trajectories:
    """Record ticks 0, every, 2 every ... of the runs seeds[L], `rows` of them; all runs share one schedule."""
    ticks = jnp.arange(interval * (rows - 1) + 1)

    def one(seed: Array) -> Trajectories:
        start, params, draws = _init_run(layout, p, root_seed, seed)

        def read(k: Array, run: Run) -> Trajectories:
            e = simulate_runs.errors(layout, p, params, k, run)
            squares = simulate_runs.normalized_errors(layout, p, k, run, e) if layout.consistency else {}
            return Trajectories(
                x=truth(layout, params, present(p, k, True), run.x),
                estimates={label: o.estimate(p.gains[label], run.memories[label]) for label, o in layout.observers},
                newest=_newest(_arrivals(layout, p, k, run)),
                target=closed_loop.set_point_at(layout, p, k),
                sigma=sigma(layout, p, k, run),
                nees={label: (square.nees, square.states) for label, square in squares.items()},
                errors=simulate_runs.user_errors(layout, p, params, k, run),
                bounds=_bounds(layout, p, run),
            )

        def step(carry: tuple[Run, Array, Trajectories], k: Array) -> tuple[tuple[Run, Array, Trajectories], None]:
            run, values, table = carry
            run, row = simulate_runs.tick(layout, p, params, draws, run, k, read)
            row = row._replace(newest=jnp.where(jnp.isnan(row.newest), values, row.newest))
            place = jnp.where(
                k % interval == 0, k // interval, rows
            )  # the last row takes the ticks that are not recorded
            set_row = partial(lax.dynamic_update_index_in_dim, index=place, axis=0)
            return (run, row.newest, jax.tree.map(lambda a, v: set_row(a, v.astype(a.dtype)), table, row)), None

        shape = jax.eval_shape(lambda: read(ticks[0], start))
        table = jax.tree.map(lambda a: jnp.zeros((rows + 1, *a.shape), a.dtype), shape)
        end = lax.scan(step, (start, jnp.full(p.noise_std.shape, jnp.nan), table), ticks)[0]
        return jax.tree.map(lambda a: a[:rows], end[2])

    out_axes: PyTree = dict.fromkeys(Trajectories._fields, -1) | {"target": None}  # the set point is common to all runs
    return jax.vmap(one, out_axes=Trajectories(**out_axes))(seeds)


def measure_runs(
    layout: Layout, p: GridPointParams, root_seed: Array, seeds: Array, x: Array, ticks: Array, numbers: Array
) -> Array:
    """Return the measurements of the runs seeds[L] with states x[N+1, n, L]: [L, K, q], NaN where none is sent.

    Each row has a tick [L, K] and its sample numbers [L, K, q], -1: none. Samples from before tick 0 measure x(0).
    """

    def one(seed: Array, x: Array, ticks: Array, numbers: Array) -> Array:
        draws = simulate_runs.draw(layout, p, root_seed, seed)
        params = params_of(layout, p, draws.plant)

        def row(sensors: PyTree, at: tuple[Array, Array]) -> tuple[PyTree, Array]:
            k, number = at
            y = simulate_runs.measure(layout, p, params, k, x[k], draws.sample(number))
            return measurements.send(p.trigger, sensors, y, number >= 0) if p.trigger else (sensors, y)

        first = measurements.first_sensors(numbers.shape[-1]) if p.trigger else ()
        return lax.scan(row, first, (ticks, numbers))[1]

    return jax.vmap(one, (0, -1, 0, 0))(seeds, x, ticks, numbers)


@cache
def jit_measure_runs() -> Any:
    """Return `measure_runs` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(measure_runs, 0)


def _init_run(
    layout: Layout, p: GridPointParams, root_seed: Array, seed: Array
) -> tuple[Run, PyTree, simulate_runs.Draws]:
    """Return a run before tick 0, its plant parameters and its random numbers."""
    draws = simulate_runs.draw(layout, p, root_seed, seed)
    params = params_of(layout, p, draws.plant)
    return simulate_runs.initial_run(layout, p, params, draws), params, draws


def sigma(layout: Layout, p: GridPointParams, k: Array, run: Run) -> dict[str, Array]:
    """Return the standard deviations of the error that observers report at tick k."""
    if not layout.consistency:
        return {}
    covariances = innovation_stats.covariances(layout, p, k, run.memories, run.commands)
    return {label: jnp.sqrt(jnp.diagonal(P)) for label, P in covariances.items()}


def _bounds(layout: Layout, p: GridPointParams, run: Run) -> dict[str, Array]:
    """Return the interval ends of observers with bounds: [2, n]."""
    return {
        label: jnp.stack(o.bounds(p.gains[label], run.memories[label])) for label, o in layout.observers if o.bounds
    }


def _arrivals(layout: Layout, p: GridPointParams, k: Array, run: Run) -> Array:
    """Return the values of each packet that arrives at tick k: [S, q], NaN: none."""
    values = run.flight.values[p.schedule.arrive[k] % layout.ring]
    return jnp.where(p.schedule.mask[k], values, jnp.nan)


def _newest(arrivals: Array) -> Array:
    """Return the newest arrival of each channel at a tick: [q], NaN: none."""
    y = arrivals[0]
    for value in arrivals[1:]:
        y = jnp.where(jnp.isnan(value), y, value)
    return y


@cache
def jit_record() -> Any:
    """Return `record` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(record, 0)


@cache
def jit_record_some() -> Any:
    """Return `record_some` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(record_some, (0, 1, 2))
