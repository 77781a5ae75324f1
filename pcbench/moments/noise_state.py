"""The part of a state that noise reaches, as one vector, and the slopes of the simulated functions along it.

Which arrays noise reaches is found as in the simulation (`engine.initial_state`). Values common to all runs, such as a filter's
covariance or a counter, are not in the vector; slopes are taken at their present values.
"""

import itertools
from collections.abc import Callable
from functools import lru_cache, partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, PyTree

from pcbench.engine import initial_state, interpreter
from pcbench.engine.lane_array import is_lanes, join, split
from pcbench.moments.dependence import argument_dependence
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, Layout

# state size up to which functions of many grid points are written entry by entry: half the run time, twice the compilation time
MOST_ENTRYWISE = 16
TERMS = 16  # longest sum written term by term, which runs fastest; longer ones are compiled as products
Rows = Callable[[Array], Array]  # [D, X, C] -> [D, X, C], linear
OneCell = Callable[..., PyTree]  # (problem, tick, state, linear inputs, other inputs) -> a vector


Result = TypeVar("Result")


class Form(NamedTuple):
    """Which parts of a layout's state noise reaches."""

    noisy: tuple[bool, ...]  # leaves of a state that noise reaches
    random: tuple[bool, ...]  # leaves that differ between runs for another reason
    flight: bool  # whether noise reaches packets in flight, in addition to the noise of the samples
    size: int  # numbers of a state
    vector_size: int  # size of the vector: numbers of a state that noise reaches


def by_shapes(f: Callable[[Layout, GridPointParams], Result]) -> Callable[[Layout, GridPointParams], Result]:
    """Apply `f` to a layout once for all problems with the same array shapes; it receives no values and no schedule."""

    @lru_cache(256)
    def once(layout: Layout, tree: PyTree, shapes: tuple[tuple[tuple[int, ...], np.dtype], ...]) -> Result:
        return f(layout, jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(*shape) for shape in shapes]))

    def call(layout: Layout, problem: GridPointParams) -> Result:
        leaves, tree = jax.tree.flatten(problem._replace(weights=()))
        layout = layout._replace(width=1, ring=1)  # irrelevant for the result
        arrays = (a if hasattr(a, "dtype") else np.asarray(a) for a in leaves)
        return once(layout, tree, tuple((a.shape, a.dtype) for a in arrays))

    return call


@by_shapes
def form_of(layout: Layout, p: GridPointParams) -> Form:
    """Return which parts of a state noise reaches."""
    start = jax.eval_shape(partial(initial_state.initial_lanes, layout), p, jnp.asarray(0), jnp.zeros(1, int))
    # the parts that moments use
    part = start._replace(plant_draws=(), flight=(), streams={}, watches={}, tracking=(), effort=())
    leaves = jax.tree.leaves(part, is_leaf=is_lanes)  # those that differ between runs are LaneArrays
    floats = [jnp.issubdtype(a.dtype, jnp.floating) for a in leaves]
    sizes = [a.parts.size * (a.rows or 1) if is_lanes(a) else a.size for a in leaves]
    noisy = tuple(is_lanes(a) and f for a, f in zip(leaves, floats, strict=True))
    return Form(
        noisy=noisy,
        random=tuple(is_lanes(a) and not f for a, f in zip(leaves, floats, strict=True)),
        flight=is_lanes(start.x) or any(is_lanes(snapshot) for snapshot in start.flight.snapshots.values()),
        size=sum(sizes),
        vector_size=sum(itertools.compress(sizes, noisy)),
    )


def vector(form: Form, state: Run) -> Array:
    """Return the vector of one grid point's state."""
    noisy = itertools.compress(jax.tree.leaves(state), form.noisy)
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(a) for a in noisy)])


def vectors(form: Form, runs: Run) -> Array:
    """Return the vectors of many runs and grid points, [runs, A, C], from leaves [runs, ..., C]."""
    return jax.vmap(jax.vmap(partial(vector, form), -1, -1))(runs)


def with_vector(form: Form, state: Run, z: Array) -> Run:
    """Return the state with another vector."""
    leaves, tree = jax.tree.flatten(state)
    first, out = 0, []
    for a, is_noisy in zip(leaves, form.noisy, strict=True):
        out.append(z[first : first + a.size].reshape(a.shape) if is_noisy else a)
        first += a.size if is_noisy else 0
    return jax.tree.unflatten(tree, out)


def with_tangent(form: Form, f: OneCell) -> OneCell:
    """Return f with its derivative: (problem, tick, state, noise, inputs, dz, d noise) -> (value, tangent)."""

    def value_and_tangent(
        p: PyTree, k: Array, state: Run, noise: Array, inputs: PyTree, dz: Array, de: Array
    ) -> PyTree:
        def f_of_vector(z: Array, w: Array) -> PyTree:
            return f(p, k, with_vector(form, state, z), w, inputs)

        return jax.jvp(f_of_vector, (vector(form, state), noise), (dz, de))

    return value_and_tangent


def jacobian(form: Form, f: OneCell, to_vector: Callable[[PyTree], Array]) -> OneCell:
    """Return the matrix of f: (problem, tick, state, noise, inputs) -> [size of f, size of state and noise]."""

    def matrix(p: PyTree, k: Array, state: Run, noise: Array, inputs: PyTree) -> Array:
        z = vector(form, state)

        def f_of_vector(zw: Array) -> Array:
            return to_vector(f(p, k, with_vector(form, state, zw[: len(z)]), zw[len(z) :], inputs))

        return jax.jacfwd(f_of_vector)(jnp.concatenate([z, noise]))

    return matrix


def product(M: Float[Array, "i j C"], X: Float[Array, "j k C"]) -> Float[Array, "i k C"]:
    """Return M X for each grid point."""
    if M.shape[1] > TERMS:
        return jnp.moveaxis(jnp.moveaxis(M, -1, 0) @ jnp.moveaxis(X, -1, 0), 0, -1)
    total = jnp.zeros((M.shape[0], *X.shape[1:]))
    for j in range(M.shape[1]):
        total = total + M[:, j, None] * X[j][None]
    return total


def transpose_cells(P: Array) -> Array:
    """Return the transpose of each grid point's matrix."""
    return jnp.swapaxes(P, 0, 1)


def outer_square(G: Float[Array, "D j C"]) -> Float[Array, "D D C"]:
    """Return G G'."""
    return product(G, transpose_cells(G))


def congruence(row_map: Rows, P: Float[Array, "D D C"]) -> Float[Array, "D D C"]:
    """Return T P T', with T the linear map `row_map` of rows."""
    return transpose_cells(row_map(transpose_cells(row_map(P))))


def is_constant(p: PyTree, per_cell: tuple[bool, ...], f: OneCell, *args: PyTree) -> bool:
    """Return whether a function depends on p alone, so that it is the same at every tick and in every state.

    `args` are its arguments other than p and the tick, for all grid points.
    """
    leaves, tree = jax.tree.flatten(p)
    shapes = [_cell_shape(a) if is_separate else a for a, is_separate in zip(leaves, per_cell, strict=True)]
    tick = jax.ShapeDtypeStruct((), int)
    dependence = argument_dependence(f, jax.tree.unflatten(tree, shapes), tick, *jax.tree.map(_cell_shape, args))
    return max(dependence, default=-1) < len(per_cell)  # arguments are p, the tick, then the others


def _cell_shape(a: PyTree) -> PyTree:
    """Return the shape of one grid point's array."""
    return jax.ShapeDtypeStruct(a.shape[:-1], a.dtype)


def map_over_cells(
    p: PyTree, per_cell: tuple[bool, ...], cells: int, entrywise: bool
) -> Callable[[OneCell], Callable[..., PyTree]]:
    """Return a function that maps functions of one grid point over the last axis; arrays `per_cell` of p are separate for each.

    If `entrywise`, functions are evaluated entry by entry, which leaves no transposes to the compiled loop.
    """
    axes = jax.tree.unflatten(jax.tree.structure(p), [-1 if is_separate else None for is_separate in per_cell])
    lanes = jax.tree.map(lambda a, axis: a if axis is None else split(a), p, axes) if entrywise else ()

    def over(f: OneCell) -> Callable[..., PyTree]:
        def by_entries(k: PyTree, *args: PyTree) -> PyTree:
            result = interpreter.vmap_entrywise(f)(lanes, k, *jax.tree.map(_entries, args))
            return jax.tree.map(partial(_join_cells, cells), result, is_leaf=is_lanes)

        def by_vmap(k: PyTree, *args: PyTree) -> PyTree:
            return jax.vmap(f, (axes, None, *(-1 for _ in args)), -1)(p, k, *args)

        return by_entries if entrywise else by_vmap

    return over


def _entries(a: PyTree) -> PyTree:
    """Return an array [..., C] as its entries; an empty array stays empty."""
    return split(a) if a.size else jnp.zeros(a.shape[:-1], a.dtype)


def _join_cells(cells: int, a: PyTree) -> Array:
    """Return an array [..., C] from entries or from a value common to all grid points."""
    return join(a) if is_lanes(a) else jnp.broadcast_to(jnp.asarray(a)[..., None], (*jnp.shape(a), cells))
