"""Normal, Student and chi-square distributions. SciPy is imported by who asks first; quantiles are computed once.

How well a delay can be known from samples of a signal that is known: the bound of Cramer and Rao.

Samples y_i = s(t_i - tau) + v_i with noise of standard deviation r tell of tau what their slopes tell:

    var(tau) >= r^2 / sum_i s'(t_i - tau)^2

of every unbiased estimate. Of a sine of amplitude a and frequency w over whole periods the sum is N a^2 w^2 / 2, hence
var(tau) >= 2 r^2 / (N a^2 w^2). Where the signal is not known, but estimated beside the delay, less is known of it.
Source: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.5.
"""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike


@cache
def normal_quantile(p: float) -> float:
    """Return the x below which a standard normal number lies with probability p."""
    from scipy.special import ndtri

    return float(ndtri(p))


@cache
def student_quantile(df: int, p: float) -> float:
    """Return the t below which Student's t lies with probability p."""
    from scipy.special import stdtrit

    return float(stdtrit(df, p))


@cache
def chi_square_exceeded(degrees: float, share: float) -> float:
    """Return what a chi-square number of so many degrees of freedom exceeds with this probability."""
    from scipy.special import chdtri

    return float(chdtri(degrees, share))


def chi_square_share(degrees: float, x: float) -> float:
    """Return with which probability a chi-square number of so many degrees of freedom exceeds x."""
    from scipy.special import chdtrc

    return float(chdtrc(degrees, x))


def delay_bound(slopes: ArrayLike, noise_std: float) -> float:
    """Return the least standard deviation [s] of an unbiased estimate of a delay, by the slopes [unit/s] at the samples.

    Infinite where no sample has a slope.
    """
    told = float(np.sum(np.square(np.asarray(slopes, float))))
    return float(noise_std / np.sqrt(told)) if told > 0 else float("inf")
