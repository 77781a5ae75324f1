"""Metrics with a reverse-mode gradient: the ticks of `simulate_runs`, in chunks.

A scan over chunks stores the state at chunk edges only. The backward pass recomputes each chunk. So the memory of a gradient
grows with the square root of the number of ticks.
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

SMOOTH = ("mae", "mse", "rmse", "max_abs_error")  # and each over the tail: the differentiable metrics


def metrics(
    layout: Layout, p: GridPointParams, ticks: int, tail: int, root_seed: Array, seeds: Array
) -> dict[str, PyTree]:
    """Return the smooth metrics of one run for each of seeds[L], by observer label, [n, L], as in the tables.

    `ticks` is the number of ticks N, `tail` the first tick of the tail. All runs share one schedule. The metrics of a run that
    exceeds every bound are not finite.
    """
    layout, size = layout._replace(watch=False), isqrt(ticks) + 1
    p = p._replace(windows=np.array([[0, tail], [tail, ticks]]))

    def one(seed: Array) -> dict[str, dict[str, Array]]:
        draws = simulate_runs.draw(layout, p, root_seed, seed)
        params = params_of(layout, p, draws.plant)

        def step(run: Run, k: Array) -> tuple[Run, None]:
            def tick(run: Run) -> Run:
                return simulate_runs.tick(layout, p, params, draws, run, k)[0]

            return lax.cond(k < ticks, tick, lambda run: run, run), None

        @jax.checkpoint
        def chunk(run: Run, start: Array) -> tuple[Run, None]:
            return lax.scan(step, run, start + jnp.arange(size))

        start = simulate_runs.initial_run(layout, p, params, draws)
        end, _ = lax.scan(chunk, start, jnp.arange(0, ticks, size))
        sums = {label: (_sum_from(s, 0), _sum_from(s, 1)) for label, s in end.streams.items()}
        return {
            label: _smooth_metrics(total, ticks, "") | _smooth_metrics(steady, ticks - tail, "steady_")
            for label, (total, steady) in sums.items()
        }

    return jax.vmap(one, out_axes=-1)(seeds)


def _sum_from(stream: ErrorSums, window: int) -> ErrorSums:
    """Return the sums over the windows from `window` on; the first window ends where the tail starts."""
    return ErrorSums(stream.absolute[window:].sum(0), stream.square[window:].sum(0), stream.peak[window:].max(0))


def _smooth_metrics(stream: ErrorSums, count: int, prefix: str) -> dict[str, Array]:
    mse = stream.square / count
    is_positive = mse > 0  # sqrt has no slope at 0; an error that is always 0 gets slope 0
    rmse = jnp.where(is_positive, jnp.sqrt(jnp.where(is_positive, mse, 1.0)), 0.0)
    values = {"mae": stream.absolute / count, "mse": mse, "rmse": rmse, "max_abs_error": stream.peak}
    return {prefix + name: value for name, value in values.items()}
