"""What noise reaches of a state, as one vector, and slopes of the simulated functions along it.

Which arrays those are is found as the simulation finds what differs between its runs (`simulation.start`). What is the same in
all runs, a filter's covariance or a counter, stays out of the vector; a slope is taken where it stands.
"""

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pcbench.simulation import start
from pcbench.simulation.lanes import is_lanes
from pcbench.simulation.problem import Layout, Problem, State

OneCell = Callable[..., Any]  # (problem, tick, state, what else enters linearly, the rest) -> a vector


class Form(NamedTuple):
    """Of the states of a layout."""

    moving: tuple[bool, ...]  # leaves of a state that noise reaches
    flight: bool  # whether it reaches what is on the network, besides the noise of the samples themselves


def form_of(layout: Layout, problem: Problem) -> Form:
    """Return what noise reaches."""
    begun = _begun(layout, problem)
    notes = any(is_lanes(each) for each in begun.flight.notes.values())
    return Form(tuple(kind == "moves" for kind in forms(layout, problem)), is_lanes(begun.x) or notes)


def forms(layout: Layout, problem: Problem) -> tuple[str, ...]:
    """Return of each leaf of a state whether it moves with the noise, is the same in all runs, or differs in another way."""
    bare = _begun(layout, problem)._replace(drawn=(), flight=(), streams={}, watches={}, tracking=(), effort=())
    leaves = jax.tree.leaves(bare, is_leaf=is_lanes)
    floats = [jnp.issubdtype(a.dtype, jnp.floating) for a in leaves]
    return tuple("same" if not is_lanes(a) else "moves" if f else "other" for a, f in zip(leaves, floats, strict=True))


def _begun(layout: Layout, problem: Problem) -> Any:
    return jax.eval_shape(
        lambda p, zero, seeds: start.begin(layout, p, zero, seeds),
        problem._replace(weights=()), jnp.asarray(0), jnp.zeros(1, int),
    )  # fmt: skip


def vector(form: Form, state: State) -> Array:
    """Return what noise reaches of a state of one cell."""
    each = itertools.compress(jax.tree.leaves(state), form.moving)
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(a) for a in each)])


def vectors(form: Form, runs: State) -> Array:
    """Return the same of many runs and cells: [runs, A, C] of leaves [runs, ..., C]."""
    return jax.vmap(jax.vmap(partial(vector, form), -1, -1))(runs)


def put(form: Form, state: State, z: Array) -> State:
    """Return the state with another vector."""
    leaves, tree = jax.tree.flatten(state)
    at, out = 0, []
    for a, moves in zip(leaves, form.moving, strict=True):
        out.append(z[at : at + a.size].reshape(a.shape) if moves else a)
        at += a.size if moves else 0
    return jax.tree.unflatten(tree, out)


def along(form: Form, f: OneCell) -> OneCell:
    """Return f with its derivative: (problem, tick, state, entering, rest, dz, d entering) -> (value, tangent)."""

    def both(p: Any, k: Array, state: State, entering: Array, rest: Any, dz: Array, de: Array) -> Any:
        def moved(z: Array, e: Array) -> Any:
            return f(p, k, put(form, state, z), e, rest)

        return jax.jvp(moved, (vector(form, state), entering), (dz, de))

    return both


def slope(form: Form, f: OneCell, flat: Callable[[Any], Array]) -> OneCell:
    """Return the matrix of f: (problem, tick, state, entering, rest) -> [numbers of f, numbers of the state and entering]."""

    def matrix(p: Any, k: Array, state: State, entering: Array, rest: Any) -> Array:
        z = vector(form, state)

        def moved(both: Array) -> Array:
            return flat(f(p, k, put(form, state, both[: len(z)]), both[len(z) :], rest))

        return jax.jacfwd(moved)(jnp.concatenate([z, entering]))

    return matrix


def over_cells(p: Any, own: tuple[bool, ...]) -> Callable[[OneCell], Callable[..., Any]]:
    """Return what carries a function of one cell over cells, on the last axis; each has its own of the arrays `own` of p."""
    axes = jax.tree.unflatten(jax.tree.structure(p), [-1 if mine else None for mine in own])

    def over(f: OneCell) -> Callable[..., Any]:
        def mapped(k: Any, *each: Any) -> Any:
            return jax.vmap(f, (axes, None, *(-1 for _ in each)), -1)(p, k, *each)

        return mapped

    return over
