"""Which inputs of the past an observer of a user's own asks for that a closed loop no longer has.

A loop keeps the inputs since the oldest sample that may still be used (`planning.controller.oldest`): beyond them `past_u` is
NaN, the estimate is NaN from there on, and every run is taken for one that diverged. The definition of a run, with observers
that are listened to, says so.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from pcbench.planning import padding
from pcbench.planning.arrays import alone, drafts
from pcbench.planning.padding import Plan
from pcbench.protocols import Now, Observer
from pcbench.simulation import trace
from pcbench.study.cells import Cell, Grid

if TYPE_CHECKING:
    import pandas as pd

Heard = Callable[[Any, Any], None]  # (age [ticks], whether there is no such input)


def sentences(grid: Grid, stats: "Callable[[], pd.DataFrame]") -> Iterator[str]:
    """Yield a sentence for each observer of a user's own that asks too much of a closed loop, of those whose runs all diverged.

    Of each scenario the first cell is looked at in which they did.
    """
    cells = {cell.key: cell for cell in grid.cells if cell.scenario.loop.controller and cell.own}
    if not cells:
        return
    found = stats()
    bad = found[(found.metric == "divergence") & (found.method == "runs") & (found["mean"] == 1.0)]
    for row in bad.drop_duplicates(["scenario", "observer"]).to_dict("records"):
        label, cell = row["observer"], cells.get((row["scenario"], row["cell"]))
        age = oldest(cell, label, grid.study) if cell and label in cell.own else None
        if age is not None:
            yield (
                f"{label}: asks past_u for the input of {age} ticks ago, which a closed loop no longer has in "
                f"{row['scenario']}: its estimates are NaN from there on, and its runs count as diverged; ask for no input "
                "from before the oldest sample that may still arrive."
            )


def oldest(cell: Cell, label: str, study: Any) -> int | None:
    """Return the oldest input [ticks] that an observer of a loop asks for in a run and does not get; None: it gets all."""
    planned = next(p for p in padding.fit(list(drafts([cell]))) if label in p.labels)
    p: Plan = alone(planned, study.root_seed, study.first_seed)
    found: list[int] = []

    def heard(age: Any, missing: Any) -> None:
        if missing:
            found.append(int(age))

    observers = tuple((name, _listened(o, heard)) for name, o in p.layout.observers)
    record = jax.jit(partial(trace.record, p.layout._replace(observers=observers)))
    jax.block_until_ready(record(p.problem, np.asarray(study.root_seed), np.asarray(study.first_seed)))
    jax.effects_barrier()
    return max(found, default=None)


def _listened(o: Observer, heard: Heard) -> Observer:
    """An observer that does the same, whose questions for inputs of the past are heard."""

    def listening(now: Now) -> Now:
        def past_u(age: Any) -> Any:
            u = now.past_u(age)
            missing = jnp.isnan(u).any()
            lax.cond(missing, lambda: jax.debug.callback(heard, age, missing), lambda: None)
            return u

        return now._replace(past_u=past_u)

    def wrapped(f: Any) -> Any:
        return f and (lambda gains, memory, now, *rest: f(gains, memory, listening(now), *rest))

    return o._replace(note=wrapped(o.note), jump=wrapped(o.jump), flow=wrapped(o.flow), sampled=wrapped(o.sampled))
