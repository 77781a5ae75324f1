"""Event-triggered sampling of a Wiener process: a sample is sent when x has moved by d since the last one (send on delta).

    dx = dw,    u''/2 = -1,    v''/2 = -x^2,    u = v = 0 at +-d

u(x) is the mean time until the exit at +-d, v(x) the mean of the integral of x^2 until then. At 0, u = d^2 and v = d^4/6: the
mean interval is d^2, and the mean variance of the estimate is v/u = d^2/6. Periodic samples at the same mean interval h = d^2
give h/2 = d^2/2, three times as much. By symmetry the estimate is constant between samples.
Source: Astrom, Bernhardsson, CDC 2002; the paper was not obtained, the equations are solved here.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_banded

# -zeta(1/2) / sqrt(2 pi): mean overshoot of a random walk over a level, in standard deviations of a step
SHIFT = 0.5826


class TriggerStats(NamedTuple):
    """Statistics of a send-on-delta trigger."""

    interval: float  # mean time between samples [s]
    variance: float  # mean variance of the estimate


def expected(threshold: float, points: int = 2000) -> TriggerStats:
    """Solve the exit-time equations on a symmetric grid of 2 `points` - 1 inner points; d is the threshold.

    The grid is a random walk of steps d/points, so the interval is exact and the variance is d^2/6 (1 - 1/points^2).
    """
    x = np.linspace(-threshold, threshold, 2 * points + 1)[1:-1]
    step = threshold / points
    bands = np.stack([np.full_like(x, 0.5), np.full_like(x, -1.0), np.full_like(x, 0.5)]) / step**2
    u, v = (solve_banded((1, 1), bands, -source)[points - 1] for source in (np.ones_like(x), x**2))
    return TriggerStats(float(u), float(v / u))


def simulate(threshold: float, step: float, steps: int, seed: int, shift: bool = True) -> TriggerStats:
    """Simulate `steps` steps of `step` seconds, from `seed`.

    A trigger that is evaluated once per step detects a level late, as if the level were higher by SHIFT sqrt(step). `shift`
    lowers the level by that, so that the result is that of the threshold in continuous time.
    """
    level = threshold - SHIFT * np.sqrt(step) if shift else threshold
    increments = np.random.default_rng(seed).standard_normal(steps) * np.sqrt(step)
    x, squares, count = 0.0, 0.0, 0
    for increment in increments.tolist():
        x_next = x + increment
        # mean of x^2 over the step, given its two ends
        squares += (x * x + x * x_next + x_next * x_next) / 3 + step / 6
        x = x_next
        if abs(x) >= level:
            x, count = 0.0, count + 1
    return TriggerStats(steps * step / max(count, 1), squares / steps)
