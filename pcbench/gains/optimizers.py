"""Two ways down: L-BFGS on gradients, and Nelder and Mead's simplex where there are none.

The training draws are fixed, so the objective is a function without noise: curvature can be learnt from its gradients, which
takes a third of the points that Adam needs. Both ask for the same points where they get the same answers, so a tuning that
was stopped goes on by getting its earlier answers again.
"""

from collections.abc import Callable

import numpy as np

from pcbench.gains.parameters import Vector

FIRST = 0.1  # length of the first step, in free parameters,
LONGEST = 1.0  # and of any, at first: where steps of that length go down, longer ones may be tried
ENOUGH = 1e-4  # of the decrease that the slope promises
SMALLEST = 1e-9  # step, of the free parameters
SPREAD = 0.25  # the simplex' first edges
Ask = Callable[[Vector], tuple[float, Vector]]  # value and slope; infinite where a point is refused


def descent(ask: Ask, start: Vector, budget: int) -> None:
    """Ask for `budget` points at most, each step halved until it goes down enough; end where none does."""
    import optax

    rule = optax.scale_by_lbfgs()
    at, (value, slope), left = start, ask(start), budget - 1
    state = rule.init(at)
    fresh, longest = True, LONGEST
    while left > 0 and slope.any():
        ahead, state = rule.update(slope, state, at)
        step = -np.asarray(ahead, float)
        if fresh or slope @ step >= 0:
            step = -slope * FIRST / np.linalg.norm(slope)
        cut = min(1.0, longest / float(np.linalg.norm(step)))
        step, tried, whole = step * cut, False, True
        while left > 0 and np.linalg.norm(step) > SMALLEST:
            there, left, tried = ask(at + step), left - 1, True
            if there[0] <= value + ENOUGH * (slope @ step) and np.isfinite(there[1]).all():
                break
            step, whole = step / 2, False
        else:
            if fresh or not tried:
                return
            state, fresh = rule.init(at), True  # what was learnt of the curvature misleads here
            continue
        at, (value, slope), fresh = at + step, there, False
        if whole and cut < 1:
            longest *= 2


def search(value: Callable[[Vector], float], start: Vector, budget: int) -> None:
    """Ask for `budget` points at most of a simplex that shrinks towards the least."""
    corners = np.vstack([start, start + SPREAD * np.eye(len(start))])
    how = {"initial_simplex": corners, "maxfev": budget, "xatol": 1e-4, "fatol": 0.0, "adaptive": len(start) > 3}
    from scipy.optimize import minimize

    minimize(value, start, method="Nelder-Mead", options=how)  # type: ignore[call-overload]
