"""How well a delay can be known from samples of a signal that is known: the bound of Cramer and Rao.

Samples y_i = s(t_i - tau) + v_i with noise of standard deviation r tell of tau what their slopes tell:

    var(tau) >= r^2 / sum_i s'(t_i - tau)^2

of every unbiased estimate. Of a sine of amplitude a and frequency w over whole periods the sum is N a^2 w^2 / 2, hence
var(tau) >= 2 r^2 / (N a^2 w^2). Where the signal is not known, but estimated beside the delay, less is known of it.
Source: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.5.
"""

import numpy as np
from numpy.typing import ArrayLike


def delay_bound(slopes: ArrayLike, noise_std: float) -> float:
    """Return the least standard deviation [s] of an unbiased estimate of a delay, by the slopes [unit/s] at the samples.

    Infinite where no sample has a slope.
    """
    told = float(np.sum(np.square(np.asarray(slopes, float))))
    return float(noise_std / np.sqrt(told)) if told > 0 else float("inf")
