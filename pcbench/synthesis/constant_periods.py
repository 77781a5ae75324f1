"""Largest constant sampling period at which an error with a linear map from sample to sample decays.

An error e(k+1) = M(T) e(k) decays if and only if the spectral radius of M(T) is below 1. The limits here are exact for a
constant period T. A varying period may destabilise an error that every constant period in its range stabilises.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

from pcbench.dynamics.linear import Matrix
from pcbench.errors import DesignError


def held_map(A: Matrix, L: Matrix, C: Matrix, seconds: float) -> Matrix:
    """Return M(s) [n, n] of e' = A e - L C e(t_k) over s seconds: an observer that holds its innovation between samples.

    M(s) = e^{A s} - (integral of e^{A r} over r = 0 .. s) L C. Also of a loop u = -K x(t_k) that is held, with L = B and C = K.
    """
    n, q = L.shape
    block = np.zeros((n + q, n + q))
    block[:n, :n], block[:n, n:] = A, -L
    flow_map = expm(block * seconds)
    return np.asarray(flow_map[:n, :n] + flow_map[:n, n:] @ C)


def predictor_map(A: Matrix, L: Matrix, C: Matrix, seconds: float) -> Matrix:
    """Return M(s) [n, n] of an observer with an output predictor w' = C f, w = y at a sample, and innovation w - C xhat.

    e' = A e - L g with g' = -C L g and g = C e at a sample.
    """
    n, q = L.shape
    flow_map = expm(np.block([[A, -L], [np.zeros((q, n)), -C @ L]]) * seconds)
    return np.asarray(flow_map[:n, :n] + flow_map[:n, n:] @ C)


def jump_map(A: Matrix, K: Matrix, C: Matrix, seconds: float) -> Matrix:
    """Return M(s) = e^{A s} (I - K C) [n, n]: the estimate jumps by K (y - C xhat) at a sample, then flows for s seconds."""
    return np.asarray(expm(A * seconds) @ (np.eye(len(A)) - K @ C))


def largest_stable(radius: Callable[[float], float], upper: float, steps: int = 100) -> float:
    """Return the first period at which a spectral radius passes 1: below it every constant period is stable.

    `radius` takes a period. It is searched on a grid of `steps` periods up to `upper`, and refined by bisection; so a range
    of instability that is shorter than upper / steps may be missed. Raises DesignError if it is below 1 on the whole grid, or
    above 1 from the first period on.
    """
    from scipy.optimize import brentq  # takes a tenth of a second to import

    grid = np.linspace(upper / steps, upper, steps)
    first_unstable = next((i for i, period in enumerate(grid) if radius(float(period)) > 1), None)
    if not first_unstable:
        problem = "stable at all" if first_unstable is None else "unstable at the first"
        raise DesignError(
            f"the search for the largest constant period: got errors that are {problem} of {steps} periods up to {upper:g}, "
            "expected a limit between them; search another range."
        )
    return float(brentq(lambda period: radius(period) - 1, grid[first_unstable - 1], grid[first_unstable], xtol=1e-13))
