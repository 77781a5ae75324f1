"""Is a plant's tick affine in its state? A look at one tick, before a program is made for a cell that cannot be exact."""

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.planning.padding import Plan
from pcbench.protocols import Now

ROUNDING = 1e-9  # of the largest number in a comparison; found on affine cells: below 1e-12
KEY = 20190131  # of where it is looked: no result depends on it


def bent(p: Plan) -> float:
    """Return f(x + d) + f(x - d) - 2 f(x) of a tick as a part of its size, the largest of some; 0 where no noise reaches x."""
    layout, problem = p.layout, p.problem
    reached = layout.controller or layout.random_initial_state or len(problem.process_std)
    if not reached or layout.drifting:
        return 0.0
    n, m, params = len(problem.x0), problem.inputs.shape[1], jax.tree.map(jnp.asarray, problem.params)
    u, worst = jnp.zeros(m), 0.0
    now = Now(jnp.asarray(0.0), jnp.asarray(0), jnp.asarray(problem.dt), u, lambda age: u)
    wide = np.abs(problem.x0) + np.sqrt(np.sum(np.square(problem.spread0), 1)) + problem.band[:n]
    for d in np.random.default_rng(KEY).normal(size=(3, n)) * wide:
        up, down, middle = (
            np.asarray(layout.plant.step(params, now, jnp.asarray(problem.x0 + s * d))) for s in (1, -1, 0)
        )
        size = np.abs([up, down, middle]).max()
        bend = np.abs(up + down - 2 * middle).max() / size if size else 0.0
        worst = max(worst, float(bend) if np.isfinite(bend) else np.inf)
    return worst
