"""Check that a batch of runs is the runs one at a time, carried over lanes as pcbench does it and as vmap does."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.checking.result import require
from pcbench.checking.tracing import Asked
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.lane_array import is_lanes, join, split
from pcbench.errors import UserError, raised

WIDTH, CLOSE = 3, 1e-11  # sums over lanes may be in another order


def same_in_lanes(every: Sequence[Asked], rows: Sequence[Any], with_: Callable[[Any], Any]) -> str:
    """Each lane of a batch is what the run gives alone; `rows` are what differs between lanes, `with_` puts the rest beside."""
    stacked = jax.tree.map(lambda *a: jnp.stack(a, -1), *rows)

    def all_of(some: Sequence[Asked]) -> Any:
        return lambda own: {a.name: a.f(with_(own)) for a in some}

    def alone(some: Sequence[Asked]) -> Any:
        f = jax.jit(all_of(some))
        return jax.tree.map(lambda *a: jnp.stack(a, -1), *map(f, rows))

    def entrywise(some: Any) -> Any:
        return jax.jit(lambda s: _whole(vmap_entrywise(all_of(some))(jax.tree.map(_split, s))))(stacked)

    ways = {
        "vmap over the last axis": lambda some: jax.jit(jax.vmap(all_of(some), -1, -1))(stacked),
        "pcbench's lanes": entrywise,
    }
    expected = alone(every)
    for way, run in ways.items():
        try:
            batch = run(every)
        except Exception:
            _name_the_one(way, run, every)
            raise
        for name, one in expected.items():
            require(
                _close(batch[name], one),
                f"lanes: {name} under {way}: got other numbers than one run at a time gives, expected the same; let no run "
                "depend on how many there are.",
            )
    return f"{len(rows)} runs at once are the same as one at a time"


def _name_the_one(way: str, run: Any, every: Sequence[Asked]) -> None:
    """Raise UserError for the function that cannot be batched."""
    for a in every:
        try:
            run([a])
        except Exception as error:
            raise UserError(
                f"lanes: {a.name} under {way}: got {raised(error)}, expected a batch of runs; write it in jax.numpy, without "
                "callbacks into Python."
            ) from None


def moved(tree: Any, i: int) -> Any:
    """Return what another lane has in place of a pytree: its real numbers differ."""
    return jax.tree.map(lambda a: a * (1 + i / 8) + i / 16 if jnp.issubdtype(a.dtype, jnp.floating) else a, tree)


def _split(a: Any) -> Any:
    """An array over lanes; what is empty differs in none."""
    return split(a) if a.size else a[..., 0]


def _whole(tree: Any) -> Any:
    """Join what is split; what does not differ between lanes is the same in each."""

    def one(x: Any) -> Any:
        return join(x) if is_lanes(x) else jnp.broadcast_to(jnp.asarray(x)[..., None], (*jnp.shape(x), WIDTH))

    return jax.tree.map(one, tree, is_leaf=is_lanes)


def _close(a: Any, b: Any) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x.shape == y.shape and np.allclose(x, y, rtol=CLOSE, atol=CLOSE, equal_nan=True) for x, y in pairs)
