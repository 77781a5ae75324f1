"""Normal, Student and chi-square distributions, and a bound for delay estimates. SciPy is imported on first use.

Cramer-Rao bound of a delay tau for a known signal s, from samples y_i = s(t_i - tau) + v_i with noise of standard deviation r:

    var(tau) >= r^2 / sum_i s'(t_i - tau)^2

for every unbiased estimate. For a sine of amplitude a and frequency w over whole periods the sum is N a^2 w^2 / 2, so
var(tau) >= 2 r^2 / (N a^2 w^2). If the signal is estimated together with the delay, the variance is larger.
Source: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.5.
"""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike


@cache
def normal_quantile(p: float) -> float:
    """Return the quantile of the standard normal distribution at probability p."""
    from scipy.special import ndtri

    return float(ndtri(p))


@cache
def student_quantile(df: int, p: float) -> float:
    """Return the quantile of Student's t with df degrees of freedom at probability p."""
    from scipy.special import stdtrit

    return float(stdtrit(df, p))


@cache
def chi_square_exceeded(degrees: float, share: float) -> float:
    """Return the value that a chi-square number exceeds with probability `share`."""
    from scipy.special import chdtri

    return float(chdtri(degrees, share))


def chi_square_share(degrees: float, x: float) -> float:
    """Return the probability that a chi-square number exceeds x."""
    from scipy.special import chdtrc

    return float(chdtrc(degrees, x))


def delay_bound(slopes: ArrayLike, noise_std: float) -> float:
    """Return the least standard deviation [s] of an unbiased delay estimate, from the slopes [unit/s] at the samples.

    Infinite if no sample has a slope.
    """
    information = float(np.sum(np.square(np.asarray(slopes, float))))
    return float(noise_std / np.sqrt(information)) if information > 0 else float("inf")
