"""Find past inputs that a user-defined observer reads although its closed loop no longer stores them.

A loop stores the inputs since the oldest sample that may still be used (`planning.loop_setup.oldest`). For an older one
`past_u` returns NaN. The estimate is then NaN to the end, and all runs count as diverged. To report the cause, one run is
simulated by the definition, with observers that report each NaN that `past_u` returns.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.planning import padding
from pcbench.planning.build import alone, drafts
from pcbench.planning.padding import Plan
from pcbench.protocols import Now, Observer
from pcbench.simulation import trajectory
from pcbench.study import Study
from pcbench.study.grid import Cell, Grid

if TYPE_CHECKING:
    import pandas as pd

Report = Callable[[Array, Array], None]  # (age [ticks], whether the input of that age is missing)


def explain_divergence(grid: Grid, stats: "Callable[[], pd.DataFrame]") -> Iterator[str]:
    """Yield a sentence for each user-defined observer whose runs all diverged because it read an input that is not stored.

    `stats()` returns the statistics of the study's runs; it is called only if a closed loop has a user-defined observer. For
    each scenario and observer, the first grid point at which all runs diverged is simulated.
    """
    cells = {cell.key: cell for cell in grid.cells if cell.scenario.loop.controller and cell.user_observers}
    if not cells:
        return
    table = stats()
    diverged = table[(table.metric == "divergence_rate") & (table.method == "runs") & (table["mean"] == 1.0)]
    for row in diverged.drop_duplicates(["scenario", "observer"]).to_dict("records"):
        label, cell = row["observer"], cells.get((row["scenario"], row["cell"]))
        age = oldest_missing_input(cell, label, grid.study) if cell and label in cell.user_observers else None
        if age is not None:
            yield (
                f"{label}: asks past_u for the input of {age} ticks ago, which the closed loop of {row['scenario']} no longer "
                "stores, so its estimates are NaN from there on and all its runs count as diverged; ask for no input from "
                "before the oldest sample that may still arrive."
            )


def oldest_missing_input(cell: Cell, label: str, study: Study) -> int | None:
    """Return the age [ticks] of the oldest input that is read but not stored in one run; None: all are stored."""
    plan = next(p for p in padding.fit(list(drafts([cell]))) if label in p.labels)
    p: Plan = alone(plan, study.root_seed, study.first_seed)
    ages: list[int] = []

    def report(age: Array, missing: Array) -> None:
        if missing:  # under vmap the callback runs for every element
            ages.append(int(age))

    observers = tuple((name, _with_report(o, report)) for name, o in p.layout.observers)
    record = jax.jit(partial(trajectory.record, p.layout._replace(observers=observers)))
    jax.block_until_ready(record(p.problem, np.asarray(study.root_seed), np.asarray(study.first_seed)))
    jax.effects_barrier()
    return max(ages, default=None)


def _with_report(o: Observer, report: Report) -> Observer:
    """Return an observer with the same estimates that reports each read of an input that is not stored."""

    def watch(now: Now) -> Now:
        def past_u(age: Array) -> Array:
            u = now.past_u(age)
            missing = jnp.isnan(u).any()
            lax.cond(missing, lambda: jax.debug.callback(report, age, missing), lambda: None)
            return u

        return now._replace(past_u=past_u)

    def wrap(f: Any) -> Any:
        return f and (lambda gains, memory, now, *rest: f(gains, memory, watch(now), *rest))

    return o._replace(snapshot=wrap(o.snapshot), jump=wrap(o.jump), flow=wrap(o.flow), on_sample=wrap(o.on_sample))
