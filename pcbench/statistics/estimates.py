"""Estimates over runs with standard error and 95 % interval, for many rows at once. NumPy and SciPy, no jax.

* `student`: mean, with Student's interval. Source: Student, Biometrika 6 (1908), 1-25.
* `root`: pooled rms, the root of a mean square: the interval is that of the mean square, its ends under the root
  (a root is monotone, so it covers exactly as often); the standard error is by the delta method.
* `reached`: bound / pooled rms, likewise.
* `wilson`: a fraction. Source: Wilson, J. Am. Stat. Assoc. 22 (1927), 209-212.

Where they cover (tests/test_coverage.py). Student's: 93.5 to 96.5 % where the metric's skewness over runs is at most
2 from 64 runs on (an error's mean size, a mean square of two or more degrees of freedom), 3 from 256 on (a mean square
of one degree), 6 from 1024 on (a log-normal of sigma 1). Not claimed: less skewness or more runs are needed; 16 runs of
skewness 2 are covered in 91 %, 64 of skewness 3 in 93 %, 64 and 256 of skewness 6 in 91 and 93 %, the intervals mostly
lying too low. Hall's cubic correction (J. R. Stat. Soc. B 54 (1992), 221-228) had 94, 95, 93 and 94 % in these
experiments, and within 1 % of Student's in the others; the plain interval stays, which is that of the paired test too.
Wilson's: 93.5 to 96.5 % for every fraction from .02 to .5 from 1024 runs on. With fewer it swings with the fraction, for
runs are whole: between 93.3 and 97.3 % of 256 (within 93.5 to 96.5 % for 99 % of the fractions), between 92.7 and 97.9 %
of 64 (91 %); on average over fractions it is 95 %.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from pcbench.statistics.moments import Moments, Values

Z95 = 1.959963984540054  # quantile of the normal distribution


class Estimate(NamedTuple):
    """Estimates [K] over n runs; NaN where there are too few."""

    n: int
    mean: Values
    se: Values
    ci_low: Values
    ci_high: Values


def student(m: Moments) -> Estimate:
    """Return the means with Student's 95 % interval; no width where the runs do not vary."""
    blank = np.full(m.mean.shape, np.nan)
    if m.n < 2:
        return Estimate(m.n, m.mean if m.n else blank, blank, blank, blank)
    se = np.sqrt(m.m2 / (m.n - 1)) / np.sqrt(m.n)
    half = se * float(stdtrit(m.n - 1, 0.975))
    return Estimate(m.n, m.mean, se, m.mean - half, m.mean + half)


def root(squares: Estimate) -> Estimate:
    """Return the roots of mean squares."""
    centre = np.sqrt(squares.mean)
    se = np.where(centre > 0, squares.se / (2 * np.where(centre > 0, centre, 1.0)), squares.se)
    low, high = np.sqrt(np.maximum(squares.ci_low, 0.0)), np.sqrt(squares.ci_high)
    return Estimate(squares.n, centre, se, low, high)


def reached(bound: Values, pooled: Estimate) -> Estimate:
    """Return bound [K] / pooled rms; NaN where the rms (or an end of its interval) is zero."""

    def over(rms: Values) -> Values:
        return np.where(rms > 0, bound / np.where(rms > 0, rms, 1.0), np.nan)

    value = over(pooled.mean)
    se = value * pooled.se / np.where(pooled.mean > 0, pooled.mean, 1.0)
    return Estimate(pooled.n, value, se, over(pooled.ci_high), over(pooled.ci_low))


def wilson(count: NDArray[np.int64], n: int) -> Estimate:
    """Return count [K] / n, the fraction of runs in which something happened, with Wilson's 95 % interval."""
    if not n:
        blank = np.full(np.shape(count), np.nan)
        return Estimate(0, blank, blank, blank, blank)
    p, z2 = np.asarray(count) / n, Z95**2
    centre, half = p + z2 / (2 * n), Z95 * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    low = np.where(p > 0, (centre - half) / (1 + z2 / n), 0.0)
    high = np.where(p < 1, (centre + half) / (1 + z2 / n), 1.0)
    return Estimate(n, p, np.sqrt(p * (1 - p) / n), low, high)
