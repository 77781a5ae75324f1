"""A value of many cells at once: of runs, the first of them without noise, and its derivatives along directions.

What happens is written for one cell and one lane. A `Carry` takes it over C cells, and `jax.vmap` over runs and directions;
what is linear in the state is found by differentiating the simulated function itself. Between events a state of few numbers is
kept entry by entry (`lanes`), which runs fastest; at events, and where there are many, in whole arrays, which compile soonest.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pcbench.simulation import lanes
from pcbench.simulation.lanes import is_lanes
from pcbench.simulation.lanes.entrywise import over

Tree = Any  # a pytree of arrays [..., C], or of Lanes over the cells
OneLane = Callable[..., Any]  # (problem, tick, state, what enters linearly, the rest) -> value


class Bundle(NamedTuple):
    """C cells; 1 + P runs, the first without noise; R directions, the last P of which are those of the runs with noise."""

    runs: Tree  # [1 + P, ..., C]
    directions: Tree  # [R, ..., C]; None for what is not a floating-point number

    @property
    def mean(self) -> Tree:
        """Return the run without noise."""
        return jax.tree.map(lambda a: a[0], self.runs)


class Carry(NamedTuple):
    """How functions of one cell are carried over cells."""

    over: Callable[[OneLane], Callable[..., Tree]]  # f -> the same of (tick, state, given, fixed, ...) of all cells
    like: Callable[[Tree], Tree] = lambda tree: tree  # a value -> in the form in which it is kept


def floats(tree: Tree) -> list[Any]:
    """Return the floating-point leaves that have a size: those that can have a derivative."""
    return [leaf for leaf in jax.tree.leaves(tree, is_leaf=is_lanes) if _moves(leaf)]


def with_floats(tree: Tree, new: list[Any]) -> Tree:
    """Return the tree with other floating-point leaves."""
    rest = iter(new)
    return jax.tree.map(lambda leaf: next(rest) if _moves(leaf) else leaf, tree, is_leaf=is_lanes)


def only_floats(tree: Tree, new: list[Any]) -> Tree:
    """Return leaves in the places that they have in a tree, None in all others."""
    rest = iter(new)
    return jax.tree.map(lambda leaf: next(rest) if _moves(leaf) else None, tree, is_leaf=is_lanes)


def through(f: OneLane, carry: Carry, k: Any, state: Bundle, given: Bundle, fixed: Any = ()) -> Bundle:
    """Return the value of f for every run, and its derivative along every direction at the run without noise.

    `given` enters f as the state does, `fixed` is the same for all runs of a cell.
    """

    def value(state: Tree, given: Tree) -> Tree:
        return carry.like(carry.over(f)(k, state, given, fixed))

    def slope(p: Any, k: Any, state: Tree, given: Tree, fixed: Any, along: list[Any]) -> list[Any]:
        def moved(each: list[Any]) -> list[Any]:
            own, entering = with_floats((state, given), each)
            return floats(f(p, k, own, entering, fixed))

        return jax.jvp(moved, (floats((state, given)),), (along,))[1]

    def derivative(*along: Any) -> list[Any]:
        found = carry.over(slope)(k, state.mean, given.mean, fixed, jax.tree.leaves(along, is_leaf=is_lanes))
        return floats(carry.like(with_floats(first, found)))

    runs = jax.vmap(value)(state.runs, given.runs)
    first = jax.tree.map(lambda a: a[0], runs)
    return Bundle(runs, only_floats(first, jax.vmap(derivative)(state.directions, given.directions)))


def arrays(p: Any, own: tuple[bool, ...]) -> Carry:
    """Carry over cells by `jax.vmap`, the cells on the last axis; `own` are the arrays of p that each cell has its own of."""
    axes = jax.tree.unflatten(jax.tree.structure(p), [-1 if mine else None for mine in own])

    def over_cells(f: OneLane) -> Callable[..., Tree]:
        def mapped(k: Any, *each: Any) -> Tree:
            return jax.vmap(f, (axes, None, *(-1 for _ in each)), -1)(p, k, *each)

        return mapped

    return Carry(over_cells)


def entries(p: Any, own: tuple[bool, ...], like: Callable[[Tree], Tree]) -> Carry:
    """Carry over cells entry by entry: every number of a cell is an array [C] of its own."""
    leaves, tree = jax.tree.flatten(p)
    laid = jax.tree.unflatten(tree, [lanes.split(a) if mine else a for a, mine in zip(leaves, own, strict=True)])
    return Carry(lambda f: lambda k, *each: over(f)(laid, k, *each), like)


def _moves(leaf: Any) -> bool:
    return math.prod(leaf.shape) > 0 and jnp.issubdtype(leaf.dtype, jnp.floating)
