"""Cheap checks of a grid point before its program is compiled: functions are traced, or evaluated at a few points.

- `plant_curvature`: is a plant's tick affine in its state? A nonlinear plant has no exact moments.
- `is_curved`: does the slope of a tick depend on values that noise reaches? Then the observer is probably not affine. One
  realisation decides this, which saves the others. False positives are possible (for instance a limit that is never reached),
  false negatives are unlikely.
- `uses_last_arrival`: does an observer use `ticks_since_arrival`? Then the effect of an arrival depends on the previous sample,
  and so on losses.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from pcbench.moments.dependence import argument_dependence
from pcbench.moments.events import jump, sense
from pcbench.moments.inputs import initial_run
from pcbench.moments.noise_state import OneCell, by_shapes, form_of, jacobian, vector
from pcbench.moments.propagate import one_cell, tick_vector
from pcbench.planning.padding import Plan
from pcbench.protocols import Arrival, Now
from pcbench.scenarios.scenario import Sampling
from pcbench.simulation import simulate_runs
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import ArrivalInfo, GridPointParams, Layout

ROUNDING = 1e-9  # relative to the largest number in a comparison; affine grid points stay below 1e-12
MOST_NUMBERS = 1024  # that noise reaches: their covariance has the square of it, for each of eight grid points
SEED = 20190131  # seed of the points at which a plant is evaluated; no result depends on it


def refusal_beforehand(p: Plan) -> str:
    """Return a clause why an observer has no exact moments, if that is known without them; else empty."""
    if why := _unsupported_samples(p.cell.scenario.sampling):
        return f"has samples {why}"
    if (numbers := form_of(p.layout, p.problem).vector_size) > MOST_NUMBERS:
        return f"keeps {numbers:,} numbers, where exact moments follow the covariance of at most {MOST_NUMBERS:,}"
    return ""


def _unsupported_samples(sampling: Sampling) -> str:
    """Return a clause why samples have no exact moments; empty if they have."""
    if chance := sampling.outlier_probability:
        return f"of which {100 * np.max(chance):g} % are outliers, whose noise is not normal"
    if sampling.noise_correlation:
        return "whose noise is correlated between channels, which exact moments do not follow"
    if np.isfinite(degrees := sampling.student_t_dof):
        return f"whose noise is Student's t with {degrees:g} degrees, which is not normal"
    if sampling.sensors_decide:
        return "that are sent or not by what they measure, which is not affine in the noise"
    if any(sampling.quantization_step):
        return "that are rounded, which is not affine in what is measured"
    return ""


def plant_curvature(p: Plan) -> float:
    """Return the largest f(x + d) + f(x - d) - 2 f(x) of a tick relative to its size; 0 if no noise reaches x."""
    layout, problem = p.layout, p.problem
    has_noise = layout.controller or layout.random_initial_state or len(problem.process_std)
    if not has_noise or layout.drifting:
        return 0.0
    n, m, params = len(problem.x0), problem.inputs.shape[1], jax.tree.map(jnp.asarray, problem.params)
    u, worst = jnp.zeros(m), 0.0
    now = Now(jnp.asarray(0.0), jnp.asarray(0), jnp.asarray(problem.dt), u, lambda age: u)
    spread = np.abs(problem.x0) + np.sqrt(np.sum(np.square(problem.spread0), 1)) + problem.band[:n]
    for d in np.random.default_rng(SEED).normal(size=(3, n)) * spread:
        up, down, middle = (
            np.asarray(layout.plant.step(params, now, jnp.asarray(problem.x0 + s * d))) for s in (1, -1, 0)
        )
        size = np.abs([up, down, middle]).max()
        ratio = np.abs(up + down - 2 * middle).max() / size if size else 0.0
        worst = max(worst, float(ratio) if np.isfinite(ratio) else np.inf)
    return worst


def is_curved(layout: Layout, problem: GridPointParams) -> bool:
    """Return whether a slope may depend on values that noise reaches, in an open loop."""
    return not layout.controller and _is_curved(layout, problem._replace(schedule=()))


@by_shapes
def _is_curved(layout: Layout, p: GridPointParams) -> bool:
    form = form_of(layout, p)
    if not any(form.noisy):
        return False
    zero, q = jnp.asarray(0), p.noise_std.shape[0]
    state = _initial_shapes(layout, p)
    packet = jax.eval_shape(lambda p, state: sense(layout, p, zero, state, (), ()), p, state)
    info = ArrivalInfo(jnp.ones(q, bool), jnp.zeros(q, int), jnp.zeros(q, int), zero)

    def slope_varies(f: OneCell, to_vector: Callable[..., Array], w: PyTree, inputs: PyTree) -> bool:
        def matrix(state: Run, p: GridPointParams, k: Array, noise: PyTree) -> Array:
            return jacobian(form, f, to_vector)(p, k, state, noise, inputs)

        leaves = argument_dependence(matrix, state, p, zero, w)
        return any(is_noisy and leaf in leaves for leaf, is_noisy in enumerate(form.noisy))

    process = jax.ShapeDtypeStruct(p.process_std.shape, float)
    arrival = partial(jump, layout), partial(vector, form), packet, (jnp.asarray(True), info)
    return slope_varies(partial(one_cell, layout), partial(tick_vector, form), process, ()) or slope_varies(*arrival)


def uses_last_arrival(layout: Layout, problem: GridPointParams) -> bool:
    """Return whether an observer may use the time since the last arrival."""
    return _uses_last_arrival(layout, problem._replace(schedule=()))


@by_shapes
def _uses_last_arrival(layout: Layout, p: GridPointParams) -> bool:
    zero, q, run = jnp.asarray(0), p.noise_std.shape[0], _initial_shapes(layout, p)
    snapshot_of = lambda p, r: simulate_runs.take_snapshots(layout, p, zero, r.memories, r.commands)  # noqa: E731
    snapshots = jax.eval_shape(snapshot_of, p, run)

    def arrive(ticks_since_arrival: Array, p: GridPointParams, run: Run, snapshots: dict[str, Array]) -> PyTree:
        none = jnp.zeros(q, int)
        arrival = partial(Arrival, jnp.zeros(q), jnp.ones(q, bool), none, none, ticks_since_arrival=ticks_since_arrival)
        return simulate_runs.jump(layout, p, zero, run, snapshots, arrival)

    jaxpr = jax.make_jaxpr(arrive)(zero, p, run, snapshots).jaxpr
    return any(v is jaxpr.invars[0] for v in [*jaxpr.outvars, *(v for e in jaxpr.eqns for v in e.invars)])


def _initial_shapes(layout: Layout, p: GridPointParams) -> Run:
    """Return the shapes of a state before tick 0."""
    return jax.eval_shape(lambda p: initial_run(layout, p, jnp.asarray(0), (), jnp.zeros(2 * p.x0.shape[0]), ()), p)
