"""What noise reaches of a state, as one vector, and slopes of the simulated functions along it.

Which arrays those are is found as the simulation finds what differs between its runs (`engine.initial_state`). What is the
same in all runs, a filter's covariance or a counter, stays out of the vector; a slope is taken at its present value.
"""

import itertools
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pcbench.engine import initial_state, interpreter
from pcbench.engine.lane_array import is_lanes, join, split
from pcbench.engine.products.affine_detection import reach
from pcbench.moments.inputs import SMALL
from pcbench.simulation.simulate_runs import Run
from pcbench.simulation.types import GridPointParams, Layout

WRITTEN_OUT = 16  # numbers of a state up to which functions of many cells go entry by entry: half the time, but
# twice as long to compile
OneCell = Callable[..., Any]  # (problem, tick, state, what else enters linearly, the rest) -> a vector


class Form(NamedTuple):
    """Of the states of a layout."""

    moving: tuple[bool, ...]  # leaves of a state that noise reaches
    flight: bool  # whether it reaches what is on the network, besides the noise of the samples themselves
    many: int  # numbers of a state


def form_of(layout: Layout, problem: GridPointParams) -> Form:
    """Return what noise reaches."""
    return _form(*_kind(layout, problem))


def forms(layout: Layout, problem: GridPointParams) -> tuple[str, ...]:
    """Return of each leaf of a state whether it moves with the noise, is the same in all runs, or differs in another way."""
    return _forms(*_kind(layout, problem))


Kind = tuple[Layout, Any, tuple[Any, ...]]  # of cells that begin alike: their layout, and the shapes of their numbers


def _kind(layout: Layout, problem: GridPointParams) -> Kind:
    leaves, tree = jax.tree.flatten(problem._replace(weights=()))
    layout = layout._replace(width=1, ring=1, lifted=0)  # what no beginning looks at
    return layout, tree, tuple((np.shape(a), np.result_type(a)) for a in leaves)


@lru_cache(256)
def _form(*kind: Any) -> Form:
    begun, found = _begun(*kind), _forms(*kind)
    notes = any(is_lanes(each) for each in begun.flight.notes.values())
    many = sum(a.parts.size * (a.rows or 1) if is_lanes(a) else a.size for a in _bare(begun))
    return Form(tuple(kind == "moves" for kind in found), is_lanes(begun.x) or notes, many)


@lru_cache(256)
def _forms(*kind: Any) -> tuple[str, ...]:
    leaves = _bare(_begun(*kind))
    floats = [jnp.issubdtype(a.dtype, jnp.floating) for a in leaves]
    return tuple("same" if not is_lanes(a) else "moves" if f else "other" for a, f in zip(leaves, floats, strict=True))


def _bare(begun: Any) -> list[Any]:
    """The arrays of a state that moments have, those that differ between runs as entries."""
    bare = begun._replace(drawn=(), flight=(), streams={}, watches={}, tracking=(), effort=())
    return jax.tree.leaves(bare, is_leaf=is_lanes)


@lru_cache(256)
def _begun(layout: Layout, tree: Any, shapes: tuple[Any, ...]) -> Any:
    p = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(*each) for each in shapes])
    return jax.eval_shape(partial(initial_state.begin, layout), p, jnp.asarray(0), jnp.zeros(1, int))


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

    def both(p: Any, k: Array, state: Run, entering: Array, rest: Any, dz: Array, de: Array) -> Any:
        def moved(z: Array, e: Array) -> Any:
            return f(p, k, put(form, state, z), e, rest)

        return jax.jvp(moved, (vector(form, state), entering), (dz, de))

    return both


def slope(form: Form, f: OneCell, flat: Callable[[Any], Array]) -> OneCell:
    """Return the matrix of f: (problem, tick, state, entering, rest) -> [numbers of f, numbers of the state and entering]."""

    def matrix(p: Any, k: Array, state: Run, entering: Array, rest: Any) -> Array:
        z = vector(form, state)

        def moved(both: Array) -> Array:
            return flat(f(p, k, put(form, state, both[: len(z)]), both[len(z) :], rest))

        return jax.jacfwd(moved)(jnp.concatenate([z, entering]))

    return matrix


def steady(p: Any, own: tuple[bool, ...], f: OneCell, *each: Any) -> bool:
    """Return whether a function over cells gives the same at every tick and in every state: whether it reads p alone.

    `each` is what it is given besides p and the tick, for all cells.
    """
    return max(_read(p, own, f, *each), default=-1) < len(own)


def timed(p: Any, own: tuple[bool, ...], f: OneCell, *each: Any) -> bool:
    """Return whether a function over cells gives the same in every state, and changes at few ticks.

    It may read p and the tick, but no long table, whose rows are as many as ticks.
    """
    found = _read(p, own, f, *each)
    long = {i for i, (a, mine) in enumerate(zip(jax.tree.leaves(p), own, strict=True)) if not mine and a.size > SMALL}
    return max(found, default=-1) <= len(own) and not found & long


def _read(p: Any, own: tuple[bool, ...], f: OneCell, *each: Any) -> frozenset[int]:
    """The numbers of the arguments that a function reads: leaves of p, the tick, and then leaves of the others."""
    leaves, tree = jax.tree.flatten(p)
    alone = [_alone(a) if mine else a for a, mine in zip(leaves, own, strict=True)]
    found, _ = reach(f, jax.tree.unflatten(tree, alone), jax.ShapeDtypeStruct((), int), *jax.tree.map(_alone, each))
    return frozenset(found)


def _alone(a: Any) -> Any:
    """The shape of one cell's array."""
    return jax.ShapeDtypeStruct(a.shape[:-1], a.dtype)


def over_cells(p: Any, own: tuple[bool, ...], cells: int, written: bool) -> Callable[[OneCell], Callable[..., Any]]:
    """Return what carries a function of one cell over cells, on the last axis; each has its own of the arrays `own` of p.

    Functions that are `written` out, entry by entry, leave the compiled loop nothing to transpose.
    """
    axes = jax.tree.unflatten(jax.tree.structure(p), [-1 if mine else None for mine in own])
    parted = jax.tree.map(lambda a, axis: a if axis is None else split(a), p, axes) if written else ()

    def over(f: OneCell) -> Callable[..., Any]:
        def by_entries(k: Any, *each: Any) -> Any:
            found = interpreter.vmap_entrywise(f)(parted, k, *jax.tree.map(_entries, each))
            return jax.tree.map(partial(_joined, cells), found, is_leaf=is_lanes)

        def mapped(k: Any, *each: Any) -> Any:
            return jax.vmap(f, (axes, None, *(-1 for _ in each)), -1)(p, k, *each)

        return by_entries if written else mapped

    return over


def _entries(a: Any) -> Any:
    """An array [..., C] as its entries; one cell's empty one."""
    return split(a) if a.size else jnp.zeros(a.shape[:-1], a.dtype)


def _joined(cells: int, a: Any) -> Array:
    """An array [..., C] again, of what is the same in all cells too."""
    return join(a) if is_lanes(a) else jnp.broadcast_to(jnp.asarray(a)[..., None], (*jnp.shape(a), cells))
