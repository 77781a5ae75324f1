"""Exact moments of one grid point with their derivatives by an observer's gains, in forward mode and without seeds.

Forward mode can differentiate loops from event to event; reverse mode cannot. There are few directions, one for each free
parameter of a tuning. They take the places of grid points in `programs`: all with the same gains, each with its own derivative.
The matrix of a tick is recomputed if its value differs from the last tick's. At a gain of 0 only the derivative may differ. To
detect this, the last place has slightly perturbed gains (`PERTURBATION`) and no derivative.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import PyTree
from numpy.typing import NDArray

from pcbench.moments.affinity import ROUNDING, plant_curvature
from pcbench.moments.error_sums import Sums
from pcbench.moments.events import Shape
from pcbench.moments.inputs import MomentInputs, is_per_cell, stack_inputs
from pcbench.moments.noise_state import form_of
from pcbench.moments.programs import compile_program
from pcbench.moments.propagate import run
from pcbench.moments.realisations import (
    Realisation,
    draw_realisation,
    is_random,
    only_losses_random,
    realisation_over_losses,
)
from pcbench.moments.solve import CellMoments, nan_sums
from pcbench.planning.padding import Plan

PERTURBATION = 1e-3  # relative
Direction = list[NDArray[np.float64]]  # one array for each real array of the gains


class CellGradients(NamedTuple):
    """The moments and slopes of one grid point with one observer."""

    cell: CellMoments
    slopes: Sums  # [..., D] by direction


def single_realisation(p: Plan) -> Realisation | None:
    """Return the realisation of a grid point with one observer; None if its moments need drawn schedules."""
    realisation = realisation_over_losses(p) if only_losses_random(p) else None
    return realisation or (None if is_random(p) else draw_realisation(p, 0, 0))


def build_gradients(
    p: Plan, realisation: Realisation, directions: int
) -> Callable[[PyTree, list[Direction]], CellGradients]:
    """Return a function of gains and `directions` directions; it is compiled at its first call."""
    (label, _), *_ = p.layout.observers
    tree = jax.tree.structure(p.problem.gains[label])
    real = [np.issubdtype(np.result_type(a), np.floating) for a in jax.tree.leaves(p.problem.gains[label])]
    width = directions + 1
    bare = realisation.problem._replace(gains={})
    stacked = stack_inputs([bare] * width, [realisation.network] * width, [realisation.chance] * width)
    nonempty = jax.tree.map(lambda a: np.size(a) > 0, p.problem.gains[label])
    flags = jax.tree.unflatten(jax.tree.structure(stacked.problem), is_per_cell(bare))._replace(gains={label: nonempty})
    shape = Shape(width, form_of(realisation.layout, realisation.problem), tuple(jax.tree.leaves(flags)))
    curvature = plant_curvature(p)
    programs: list[Callable[..., PyTree]] = []

    def sums(inputs: MomentInputs, constants: list[Array], reals: list[Array]) -> Sums:
        real_leaves, other_leaves = iter(reals), iter(constants)
        gains = jax.tree.unflatten(tree, [next(real_leaves if is_real else other_leaves) for is_real in real])
        problem = inputs.problem._replace(gains={label: gains})
        return run(realisation.layout, shape, inputs._replace(problem=problem)).sums

    def sums_and_slopes(
        inputs: MomentInputs, constants: list[Array], reals: list[Array], tangents: list[Array]
    ) -> tuple[Sums, Sums]:
        return jax.jvp(partial(sums, inputs, constants), (reals,), (tangents,))

    def gradients(gains: PyTree, directions: list[Direction]) -> CellGradients:
        if curvature > ROUNDING:
            nan = nan_sums(len(p.problem.band), curvature)
            return CellGradients(_cell(p, realisation, nan), nan)
        leaves = [np.asarray(a) for a in jax.tree.leaves(gains)]
        reals = [_stack_perturbed(a, width) for a, is_real in zip(leaves, real, strict=True) if is_real]
        other_leaves = [a for a, is_real in zip(leaves, real, strict=True) if not is_real]
        constants = [np.stack([a] * width, -1) if a.size else a for a in other_leaves]
        empty = [np.zeros_like(a) for a, is_real in zip(leaves, real, strict=True) if is_real]
        columns = zip(*directions, empty, strict=True)
        tangents = [np.stack(column, -1) if column[0].size else column[0] for column in columns]
        args = stacked, constants, reals, tangents
        if not programs:
            key_parts = realisation.layout, shape, label, real, jax.tree.map(np.shape, p.problem.gains[label])
            programs.append(compile_program(sums_and_slopes, key_parts, *args, result_types=(Sums,)))
        value, slopes = jax.tree.map(np.asarray, programs[0](*args))
        first = jax.tree.map(lambda a: a[..., :1], value)
        return CellGradients(_cell(p, realisation, first), jax.tree.map(lambda a: a[..., :-1], slopes))

    return gradients


def _stack_perturbed(a: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return an array of gains for each place, the last one perturbed; an empty array is unchanged."""
    if not a.size:
        return a
    size = np.max(np.abs(a)) or 1.0
    step = PERTURBATION * size * np.random.default_rng(a.size).uniform(0.5, 1.0, a.shape)
    return np.stack([a] * (width - 1) + [a + step], -1)


def _cell(p: Plan, realisation: Realisation, sums: Sums) -> CellMoments:
    """Return the moments of the grid point itself."""
    return CellMoments(p, False, {p.labels[0]: slice(0, len(sums.mean))}, sums, mixture=realisation.chance < 1)
