"""Intervals of intensities by the profile likelihood, of normal samples with the variances a and a + b; P = 2, z = log (a, b).

The most likely values are the mean squares and their difference; the reference maximises over a with SciPy.
"""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from pcbench.playback import innovation_tests

N, M, V, W = 1000, 50, 1.0, 1.1  # how many samples of each kind, and their mean squares


def likelihood(z):
    a, b = np.exp(z)
    s = a + b
    value = -0.5 * (N * (np.log(a) + V / a) + M * (np.log(s) + W / s))
    first, second = -0.5 * N * (1 - V / a), -0.5 * M * (1 - W / s) / s
    return value, np.array([first + second * a, second * b])


def test_interval_is_one_sided_if_samples_do_not_exclude_zero():
    at = np.log([V, W - V])
    low, high = innovation_tests.intervals(likelihood, at)
    assert low[0] < at[0] < high[0]
    assert low[1] == -np.inf

    def drop(z):
        best = minimize_scalar(lambda a: -likelihood(np.array([a, z]))[0], bounds=(-1.0, 1.0), method="bounded")
        return 2 * (likelihood(at)[0] + best.fun)

    assert high[1] == pytest.approx(brentq(lambda z: drop(z) - 2.7055, at[1], at[1] + 5), abs=5e-3)


def test_intensity_that_does_not_change_the_likelihood_has_no_interval():
    low, high = innovation_tests.intervals(lambda z: (-5.0 * z[0] ** 2, np.array([-10.0 * z[0], 0.0])), np.zeros(2))
    assert np.isnan([low[1], high[1]]).all()
    assert [low[0], high[0]] == pytest.approx([-1.96 / 10**0.5, 1.96 / 10**0.5], rel=1e-4)
