"""Runs of many cells side by side through ticks without an event: a state as its entries, each [R C] of R runs of C cells."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from pcbench.engine import interpreter
from pcbench.engine.lane_array import everywhere, is_lanes, join, lanes_of, split


def entries(a: Array) -> Any:
    """An array [R, ..., C] of runs and cells as its entries; an empty one as it is for one of them."""
    together = jnp.moveaxis(a, 0, -2)
    return split(together.reshape(*a.shape[1:-1], a.shape[0] * a.shape[-1])) if a.size else together[..., 0, 0]


def of_problem(p: Any, own: tuple[bool, ...], runs: int) -> Any:
    """The numbers of C cells for so many runs of each."""
    leaves, tree = jax.tree.flatten(p)
    each = [split(jnp.tile(a, runs)) if mine else a for a, mine in zip(leaves, own, strict=True)]
    return jax.tree.unflatten(tree, each)


def over(f: Callable[..., Any], p: Any, width: int) -> Callable[..., Any]:
    """Return what carries a function of one cell, (problem, tick, state, entering, rest), over entries, and leaves such."""

    def mapped(k: Array, state: Any, entering: Any, rest: Any) -> Any:
        return everywhere(interpreter.vmap_entrywise(f)(p, k, state, entering, rest), width)

    return mapped


def room(like: Any, ticks: int, runs: int) -> Any:
    """Room for what so many ticks leave: `like` one run of each cell, [..., C]."""

    def one(a: Any) -> Any:
        entry = jnp.zeros((ticks, runs * a.shape[-1]))
        return (
            lanes_of(a.shape[:-1], [entry] * (a.size // a.shape[-1])) if a.size else jnp.zeros((ticks, *a.shape[:-1]))
        )

    return jax.tree.map(one, like)


def arrays(tree: Any, runs: int, cells: int) -> Any:
    """Entries of a state as arrays [R, ..., C] again."""
    return jax.tree.map(partial(_array, runs, cells), tree, is_leaf=is_lanes)


def _array(runs: int, cells: int, a: Any) -> Array:
    if not is_lanes(a):
        return jnp.zeros((runs, *a.shape, cells), a.dtype)
    whole = join(a)
    return jnp.moveaxis(whole.reshape(*whole.shape[:-1], runs, cells), -2, 0)


def of_ticks(tree: Any, runs: int, cells: int) -> Any:
    """What some ticks have left, as arrays [J, R, ..., C]."""

    def one(a: Any) -> Array:
        if not is_lanes(a):
            return jnp.zeros((len(a), runs, *a.shape[1:], cells))
        whole = jnp.stack(list(a.parts.flat), 1)  # [J, entries, R C]
        return jnp.moveaxis(whole.reshape(len(whole), *a.shape, runs, cells), -2, 1)

    return jax.tree.map(one, tree, is_leaf=is_lanes)
