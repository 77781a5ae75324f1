"""Two forms of the same numbers: arrays [L, ..., C], and Lanes whose entries are arrays [L, C] of their own."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.moments.bundle import Bundle
from pcbench.simulation import lanes
from pcbench.simulation.lanes import is_lanes
from pcbench.simulation.problem import Layout, State


def as_entries(state: Bundle, layout: Layout) -> Bundle:
    """Return a bundle of State entry by entry; the commands of a loop as a table, whose rows stay together."""

    def one(s: State) -> State:
        return _apart(s._replace(commands=()))._replace(commands=_apart(s.commands, layout.controller is not None))

    return Bundle(one(state.runs), one(state.directions))


def as_arrays(tree: Any, cells: int) -> Any:
    """Return Lanes as arrays [L, ..., C]."""

    def one(a: Any) -> Any:
        if not is_lanes(a):
            return jnp.repeat(a[..., None], cells, -1)
        rows = a.rows is not None
        each = list(a.parts.flat)
        return jnp.stack(each, 1 + rows).reshape(*each[0].shape[: 1 + rows], *a.parts.shape, cells)

    return jax.tree.map(one, tree, is_leaf=is_lanes)


def like(before: Any, cells: int) -> Callable[[Any], Any]:
    """Return what gives (a state, what is read of it) the form that the state had before, and Lanes of all that is read."""

    def arrays(tree: Any) -> Any:
        return jax.tree.map(lambda x: x if is_lanes(x) else jnp.asarray(x), tree, is_leaf=is_lanes)

    return lambda found: (
        lanes.like(arrays(found[0]), before, cells),
        lanes.everywhere(arrays(found[1]), cells),
    )


def _apart(tree: Any, rows: bool = False) -> Any:
    def one(a: Any) -> Any:
        if not a.size:
            return a[..., 0]
        shape = a.shape[1 + rows : -1]
        each = [a[(slice(None), *[slice(None)] * rows, *i)] for i in np.ndindex(shape)]
        return lanes.lanes_of(shape, each, a.shape[1] if rows else None)

    return jax.tree.map(one, tree)
