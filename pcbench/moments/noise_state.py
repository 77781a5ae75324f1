"""What noise reaches of a state, as one vector, and slopes of the simulated functions along it.

Which arrays those are is found as the simulation finds what differs between its runs (`engine.initial_state`). What is the
same in all runs, a filter's covariance or a counter, stays out of the vector; a slope is taken at its present value.
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
from pcbench.moments.dependence import reach
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, Layout

WRITTEN_OUT = 16  # numbers of a state up to which functions of many cells go entry by entry: half the time, but
# twice as long to compile
TERMS = 16  # of a sum that are written one by one, which runs fastest; longer ones are compiled as products
Rows = Callable[[Array], Array]  # [D, X, C] -> [D, X, C], linear
OneCell = Callable[..., PyTree]  # (problem, tick, state, what else enters linearly, the rest) -> a vector


Look = TypeVar("Look")


class Form(NamedTuple):
    """Of the states of a layout."""

    moving: tuple[bool, ...]  # leaves of a state that noise reaches
    other: tuple[bool, ...]  # those that differ between runs in another way
    flight: bool  # whether it reaches what is on the network, besides the noise of the samples themselves
    many: int  # numbers of a state
    reached: int  # of these, numbers that noise reaches


def by_shapes(look: Callable[[Layout, GridPointParams], Look]) -> Callable[[Layout, GridPointParams], Look]:
    """Have a look at a layout once for all problems whose arrays have the same shapes: it sees no numbers and no schedule."""

    @lru_cache(256)
    def once(layout: Layout, tree: PyTree, shapes: tuple[tuple[tuple[int, ...], np.dtype], ...]) -> Look:
        return look(layout, jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(*each) for each in shapes]))

    def call(layout: Layout, problem: GridPointParams) -> Look:
        leaves, tree = jax.tree.flatten(problem._replace(weights=()))
        layout = layout._replace(width=1, ring=1)  # what no beginning looks at
        arrays = (a if hasattr(a, "dtype") else np.asarray(a) for a in leaves)
        return once(layout, tree, tuple((a.shape, a.dtype) for a in arrays))

    return call


@by_shapes
def form_of(layout: Layout, p: GridPointParams) -> Form:
    """Return what noise reaches."""
    begun = jax.eval_shape(partial(initial_state.begin, layout), p, jnp.asarray(0), jnp.zeros(1, int))
    bare = begun._replace(drawn=(), flight=(), streams={}, watches={}, tracking=(), effort=())  # as moments have it
    leaves = jax.tree.leaves(bare, is_leaf=is_lanes)  # those that differ between runs as entries
    floats = [jnp.issubdtype(a.dtype, jnp.floating) for a in leaves]
    sizes = [a.parts.size * (a.rows or 1) if is_lanes(a) else a.size for a in leaves]
    moving = tuple(is_lanes(a) and f for a, f in zip(leaves, floats, strict=True))
    return Form(
        moving=moving,
        other=tuple(is_lanes(a) and not f for a, f in zip(leaves, floats, strict=True)),
        flight=is_lanes(begun.x) or any(is_lanes(each) for each in begun.flight.notes.values()),
        many=sum(sizes),
        reached=sum(itertools.compress(sizes, moving)),
    )


def vector(form: Form, state: Run) -> Array:
    """Return what noise reaches of a state of one cell."""
    each = itertools.compress(jax.tree.leaves(state), form.moving)
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(a) for a in each)])


def vectors(form: Form, runs: Run) -> Array:
    """Return the same of many runs and cells: [runs, A, C] of leaves [runs, ..., C]."""
    return jax.vmap(jax.vmap(partial(vector, form), -1, -1))(runs)


def put(form: Form, state: Run, z: Array) -> Run:
    """Return the state with another vector."""
    leaves, tree = jax.tree.flatten(state)
    at, out = 0, []
    for a, moves in zip(leaves, form.moving, strict=True):
        out.append(z[at : at + a.size].reshape(a.shape) if moves else a)
        at += a.size if moves else 0
    return jax.tree.unflatten(tree, out)


def along(form: Form, f: OneCell) -> OneCell:
    """Return f with its derivative: (problem, tick, state, entering, rest, dz, d entering) -> (value, tangent)."""

    def both(p: PyTree, k: Array, state: Run, entering: Array, rest: PyTree, dz: Array, de: Array) -> PyTree:
        def moved(z: Array, e: Array) -> PyTree:
            return f(p, k, put(form, state, z), e, rest)

        return jax.jvp(moved, (vector(form, state), entering), (dz, de))

    return both


def slope(form: Form, f: OneCell, flat: Callable[[PyTree], Array]) -> OneCell:
    """Return the matrix of f: (problem, tick, state, entering, rest) -> [numbers of f, numbers of the state and entering]."""

    def matrix(p: PyTree, k: Array, state: Run, entering: Array, rest: PyTree) -> Array:
        z = vector(form, state)

        def moved(both: Array) -> Array:
            return flat(f(p, k, put(form, state, both[: len(z)]), both[len(z) :], rest))

        return jax.jacfwd(moved)(jnp.concatenate([z, entering]))

    return matrix


def product(M: Float[Array, "i j C"], X: Float[Array, "j k C"]) -> Float[Array, "i k C"]:
    """Return M X, cell by cell."""
    if M.shape[1] > TERMS:
        return jnp.moveaxis(jnp.moveaxis(M, -1, 0) @ jnp.moveaxis(X, -1, 0), 0, -1)
    total = jnp.zeros((M.shape[0], *X.shape[1:]))
    for j in range(M.shape[1]):
        total = total + M[:, j, None] * X[j][None]
    return total


def transpose_cells(P: Array) -> Array:
    """Return the transpose of each cell's matrix."""
    return jnp.swapaxes(P, 0, 1)


def outer_square(G: Float[Array, "D j C"]) -> Float[Array, "D D C"]:
    """Return G G'."""
    return product(G, transpose_cells(G))


def both(move: Rows, P: Float[Array, "D D C"]) -> Float[Array, "D D C"]:
    """Return T P T', T what `move` does to rows."""
    return transpose_cells(move(transpose_cells(move(P))))


def steady(p: PyTree, own: tuple[bool, ...], f: OneCell, *each: PyTree) -> bool:
    """Return whether a function over cells gives the same at every tick and in every state: whether it reads p alone.

    `each` is what it is given besides p and the tick, for all cells.
    """
    leaves, tree = jax.tree.flatten(p)
    alone = [_alone(a) if mine else a for a, mine in zip(leaves, own, strict=True)]
    read = reach(f, jax.tree.unflatten(tree, alone), jax.ShapeDtypeStruct((), int), *jax.tree.map(_alone, each))
    return max(read, default=-1) < len(own)  # the tick is behind p, and then the others


def _alone(a: PyTree) -> PyTree:
    """The shape of one cell's array."""
    return jax.ShapeDtypeStruct(a.shape[:-1], a.dtype)


def over_cells(
    p: PyTree, own: tuple[bool, ...], cells: int, written: bool
) -> Callable[[OneCell], Callable[..., PyTree]]:
    """Return what carries a function of one cell over cells, on the last axis; each has its own of the arrays `own` of p.

    Functions that are `written` out, entry by entry, leave the compiled loop nothing to transpose.
    """
    axes = jax.tree.unflatten(jax.tree.structure(p), [-1 if mine else None for mine in own])
    parted = jax.tree.map(lambda a, axis: a if axis is None else split(a), p, axes) if written else ()

    def over(f: OneCell) -> Callable[..., PyTree]:
        def by_entries(k: PyTree, *each: PyTree) -> PyTree:
            found = interpreter.vmap_entrywise(f)(parted, k, *jax.tree.map(_entries, each))
            return jax.tree.map(partial(_join_cells, cells), found, is_leaf=is_lanes)

        def mapped(k: PyTree, *each: PyTree) -> PyTree:
            return jax.vmap(f, (axes, None, *(-1 for _ in each)), -1)(p, k, *each)

        return by_entries if written else mapped

    return over


def _entries(a: PyTree) -> PyTree:
    """An array [..., C] as its entries; one cell's empty one."""
    return split(a) if a.size else jnp.zeros(a.shape[:-1], a.dtype)


def _join_cells(cells: int, a: PyTree) -> Array:
    """An array [..., C] again, of what is the same in all cells too."""
    return join(a) if is_lanes(a) else jnp.broadcast_to(jnp.asarray(a)[..., None], (*jnp.shape(a), cells))
