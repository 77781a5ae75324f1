"""How well a log tells the noise intensities that make it most likely: an interval for each, from the observed information.

    z = log of an intensity,   H = - d/dz sum_i s_i(z),   var z = (H^-1)_jj,   interval: exp(z_j -+ 1.96 sqrt(var z_j))

s_i is the score of sample i, so H takes central differences of exact derivatives. Scores of an observer whose model is true do
not depend on the past, so no correction for dependence is made; where innovations are not white (`p_white`), intervals are too
short. On a logarithm the interval stays positive and is nearly symmetric. An intensity that the log does not tell, because its
likelihood hardly changes with it or is largest at 0, has no interval: NaN.
Source: Efron, Hinkley, Assessing the accuracy of the maximum likelihood estimator: observed versus expected Fisher information,
Biometrika 65 (1978), 457-482, of one parameter; that it holds for several and a filter's prediction errors is shown here by
counting, below.
Coverage: such intervals by the book's filter alone, of 3,000 simulated logs of 279 samples, hold R in 94.4 % and Q in 95.2 %;
those found here hold both in 90 to 99 of 100 logs (tests/replaying). Not claimed: that of fewer samples.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pcbench.gains.parameters import Vector

STEP = 1e-3  # of z; an error of H of 1e-6 of itself
NORMAL = 1.959963984540054  # 95 %
TOLD = 1.0  # least information of one z alone: else its standard deviation is more than a factor of e


class Interval(NamedTuple):
    """95 % of one number; NaN: the log does not tell it."""

    low: float
    high: float


def information(score: Callable[[Vector], Vector], at: Vector) -> np.ndarray:
    """Return the observed information [P, P], given the sum of scores [P] at a point."""
    rows = [(score(at - step) - score(at + step)) / (2 * STEP) for step in STEP * np.eye(len(at))]
    H = np.array(rows).reshape(len(at), len(at))
    return 0.5 * (H + H.T)


def deviations(H: np.ndarray) -> Vector:
    """Return the standard deviation of each z, NaN of what is not told."""
    out = np.full(len(H), np.nan)
    told = np.diag(H) > TOLD
    some = H[np.ix_(told, told)]
    if not told.any() or not np.isfinite(some).all() or np.linalg.eigvalsh(some)[0] <= 0:
        return out
    out[told] = np.sqrt(np.diag(np.linalg.inv(some)))
    return out


def around(at: Vector, sd: Vector) -> tuple[Vector, Vector]:
    """Return the ends of the intervals of z."""
    return at - NORMAL * sd, at + NORMAL * sd
