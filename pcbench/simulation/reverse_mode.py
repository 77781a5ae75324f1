"""Runs whose metrics can be differentiated backwards: the ticks of `simulate_runs`, in chunks.

A scan over chunks keeps the state at their edges only: going back, a chunk is computed again. So the memory of a gradient grows
with the square root of the horizon, not with it.
"""

from math import isqrt

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import PyTree

from pcbench.simulation import simulate_runs
from pcbench.simulation.metrics import ErrorSums
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, Layout, params_of

SMOOTH = ("mae", "mse", "rmse", "max_abs_error")  # and each of them over the tail: what a gradient can be asked of


def metrics(
    layout: Layout, p: GridPointParams, ticks: int, tail: int, root_seed: Array, seeds: Array
) -> dict[str, PyTree]:
    """Return by observer label the smooth metrics of one run for each of seeds[L], [n, L], that the tables have.

    `ticks` is the horizon N, `tail` the tick at which the tail starts. All runs share one schedule. Where a run leaves all
    bounds, its metrics are not finite.
    """
    layout, size = layout._replace(watch=False), isqrt(ticks) + 1
    p = p._replace(windows=np.array([[0, tail], [tail, ticks]]))

    def one(seed: Array) -> dict[str, dict[str, Array]]:
        drawn = simulate_runs.draw(layout, p, root_seed, seed)
        params = params_of(layout, p, drawn.plant)

        def step(run: Run, k: Array) -> tuple[Run, None]:
            def tick(run: Run) -> Run:
                return simulate_runs.tick(layout, p, params, drawn, run, k)[0]

            return lax.cond(k < ticks, tick, lambda run: run, run), None

        @jax.checkpoint
        def chunk(run: Run, start: Array) -> tuple[Run, None]:
            return lax.scan(step, run, start + jnp.arange(size))

        start = simulate_runs.initial_run(layout, p, params, drawn)
        end, _ = lax.scan(chunk, start, jnp.arange(0, ticks, size))
        found = {label: (_over(s, 0), _over(s, 1)) for label, s in end.streams.items()}
        return {o: _read(whole, ticks, "") | _read(late, ticks - tail, "steady_") for o, (whole, late) in found.items()}

    return jax.vmap(one, out_axes=-1)(seeds)


def _over(stream: ErrorSums, window: int) -> ErrorSums:
    """The sums over the windows from one on: the first ends where the tail starts."""
    return ErrorSums(stream.absolute[window:].sum(0), stream.square[window:].sum(0), stream.peak[window:].max(0))


def _read(stream: ErrorSums, count: int, prefix: str) -> dict[str, Array]:
    mse = stream.square / count
    still = mse > 0  # the root of 0 has no slope; an error that is 0 throughout has slope 0
    rmse = jnp.where(still, jnp.sqrt(jnp.where(still, mse, 1.0)), 0.0)
    values = {"mae": stream.absolute / count, "mse": mse, "rmse": rmse, "max_abs_error": stream.peak}
    return {prefix + name: value for name, value in values.items()}
