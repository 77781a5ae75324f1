"""Optimizers of a tuning: L-BFGS with gradients, and the Nelder-Mead simplex without; and the gradients.

The training runs are fixed, so the objective is a deterministic function. L-BFGS estimates its curvature, and needs a third
of the points that Adam needs. Both optimizers are deterministic, so a stopped tuning continues from its stored values.

The gradient of an objective with respect to every number among the gains is exact, through the simulator in reverse mode. The
derivatives of the gains with respect to the free parameters are central differences of the observer's own design in NumPy,
accurate to 1e-9.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree
from numpy.typing import NDArray
from pydantic import ValidationError

from pcbench.engine import runner
from pcbench.errors import UserError
from pcbench.gains.objective import Objective
from pcbench.gains.parameters import Vector
from pcbench.planning.padding import Plan
from pcbench.protocols import Gains, Leaf
from pcbench.runtime import program_store, thread_pools
from pcbench.simulation import reverse_mode
from pcbench.simulation.types import GridPointParams

FIRST = 0.1  # length of the first step, in free parameters
LONGEST = 1.0  # initial limit of a step's length; it doubles after a successful step of that length
ARMIJO = 1e-4  # required decrease, relative to that of the gradient
SMALLEST = 1e-9  # least length of a step, in free parameters
SPREAD = 0.25  # initial edges of the simplex
Ask = Callable[[Vector], tuple[float, Vector]]  # -> value and gradient; infinite if a point is refused


def descent(ask: Ask, start: Vector, budget: int) -> None:
    """Evaluate at most `budget` points by L-BFGS; halve each step until the decrease suffices, and stop if none does."""
    import optax

    rule = optax.scale_by_lbfgs()
    at, (value, slope), evaluations_left = start, ask(start), budget - 1
    state = rule.init(at)
    is_initial, longest = True, LONGEST
    while evaluations_left > 0 and slope.any():
        direction, state = rule.update(slope, state, at)
        step = -np.asarray(direction, float)
        if is_initial or slope @ step >= 0:
            step = -slope * FIRST / np.linalg.norm(slope)
        shrink = min(1.0, longest / float(np.linalg.norm(step)))
        step, has_trial, full_step = step * shrink, False, True
        while evaluations_left > 0 and np.linalg.norm(step) > SMALLEST:
            candidate, evaluations_left, has_trial = ask(at + step), evaluations_left - 1, True
            if candidate[0] <= value + ARMIJO * (slope @ step) and np.isfinite(candidate[1]).all():
                break
            step, full_step = step / 2, False
        else:
            if is_initial or not has_trial:
                return
            state, is_initial = rule.init(at), True  # the estimated curvature is wrong here
            continue
        at, (value, slope), is_initial = at + step, candidate, False
        if full_step and shrink < 1:
            longest *= 2


def search(value: Callable[[Vector], float], start: Vector, budget: int) -> None:
    """Evaluate at most `budget` points by the Nelder-Mead simplex."""
    corners = np.vstack([start, start + SPREAD * np.eye(len(start))])
    options = {"initial_simplex": corners, "maxfev": budget, "xatol": 1e-4, "fatol": 0.0, "adaptive": len(start) > 3}
    from scipy.optimize import minimize

    minimize(value, start, method="Nelder-Mead", options=options)  # type: ignore[call-overload]


LANES = 128  # runs per call; one call per core at a time
STEP = 1e-5  # of a free parameter
# mean of an objective's base over runs, its derivative with respect to each array of gains, whether a run diverges
ValueAndGradient = tuple[float, list[Vector], bool]


def numbers(gains: Gains) -> list[Leaf]:
    """Return the arrays of real numbers among the gains, which are differentiated."""
    return [a for a in jax.tree.leaves(gains) if np.issubdtype(np.result_type(a), np.floating)]


def value_and_gradient(
    p: Plan, aim: Objective, root_seed: int, seeds: NDArray[np.int64]
) -> Callable[[Gains], ValueAndGradient]:
    """Return a function of the gains of a planned cell's one observer: the mean over runs and its derivatives."""
    (label, _), *_ = p.layout.observers
    layout = p.layout._replace(width=min(LANES, len(seeds)))
    n, tail = p.cell.times.ticks, p.cell.times.tail
    tree = jax.tree.structure(p.problem.gains[label])

    def mean(
        reals: list[Array], constants: list[Leaf], problem: GridPointParams, seeds: Array, weights: Array
    ) -> tuple[Array, Array]:
        real_leaves, constant_leaves = iter(reals), iter(constants)
        leaves = [next(real_leaves if real else constant_leaves) for real in is_real]
        problem = problem._replace(gains={label: jax.tree.unflatten(tree, leaves)})
        metrics = reverse_mode.metrics(layout, problem, n, tail, jnp.asarray(root_seed), seeds)
        peaks = metrics[label]["max_abs_error"]
        has_diverged = jnp.any(~(peaks <= problem.bound[: len(peaks), None]))
        return jnp.sum(metrics[label][aim.base][aim.signal] * weights), has_diverged

    is_real = [np.issubdtype(np.result_type(a), np.floating) for a in jax.tree.leaves(p.problem.gains[label])]
    base = p.problem._replace(gains={})
    calls = [
        _pad_seeds(seeds[i : i + layout.width], layout.width, len(seeds)) for i in range(0, len(seeds), layout.width)
    ]
    options = runner.OPTIONS if jax.devices()[0].platform == "cpu" else None
    programs: list[Callable[..., PyTree]] = []

    def at(gains: Gains) -> ValueAndGradient:
        reals = numbers(gains)
        constants = [a for a, real in zip(jax.tree.leaves(gains), is_real, strict=True) if not real]
        if not programs:
            shapes = jax.tree.map(
                lambda a: jax.ShapeDtypeStruct(np.shape(a), np.asarray(a).dtype), (reals, constants, base, *calls[0])
            )
            key = layout, n, tail, root_seed, label, is_real, aim.base, aim.signal, jax.tree.map(np.shape, gains)
            function = jax.value_and_grad(mean, has_aux=True)
            programs.append(program_store.compile_program(function, key, shapes, options))
        with thread_pools.pool(len(runner.devices())) as threads:
            parts = list(threads.map(lambda c: runner.in_float64(_run, programs[0], reals, constants, base, *c), calls))
        slopes = [sum(g) for g in zip(*(slope for _, slope, _ in parts), strict=True)]
        return sum(value for value, _, _ in parts), slopes, any(flag for _, _, flag in parts)

    return at


def chain(slopes: list[Vector], design: Callable[[Vector], Gains], at: Vector) -> Vector:
    """Return the derivatives with respect to the free parameters, from those with respect to the gains."""
    by_parameter = directions(design, at)
    return np.array([sum(float(np.sum(s * d)) for s, d in zip(slopes, row, strict=True)) for row in by_parameter])


def directions(design: Callable[[Vector], Gains], at: Vector) -> list[list[Vector]]:
    """Return the derivatives of the gains for each free parameter, NaN if the designs on both sides are refused."""
    out = []
    for step in STEP * np.eye(len(at)):
        sides = [(sign, gains) for sign in (1, -1) if (gains := _try_design(design, at + sign * step)) is not None]
        if len(sides) < 2:  # one side is refused: use the middle
            sides.append((0, numbers(design(at))))
        (m, upper), (n, lower) = sides[0], sides[-1]
        gap = (m - n) * STEP or np.nan
        out.append([(np.asarray(a) - np.asarray(b)) / gap for a, b in zip(upper, lower, strict=True)])
    return out


def _try_design(design: Callable[[Vector], Gains], at: Vector) -> list[Leaf] | None:
    """Return the gains at a point as arrays, or None if the design refuses."""
    try:
        return numbers(design(at))
    except (UserError, ValidationError):
        return None


def _pad_seeds(seeds: NDArray[np.int64], width: int, total: int) -> tuple[NDArray[np.int64], Vector]:
    weights = np.where(np.arange(width) < len(seeds), 1 / total, 0.0)
    return np.resize(seeds, width), weights


def _run(call: Callable[..., PyTree], *arguments: PyTree) -> ValueAndGradient:
    (value, has_diverged), slopes = call(*arguments)
    return float(value), [np.asarray(s) for s in slopes], bool(has_diverged)
