"""Consistency of an observer's covariance: normalized squared errors over runs, their band, the verdict. No jax.

With a correct covariance, the mean of N independent runs of e' P^-1 e / n lies in the 95 % interval of chi2(n N) / (n N). Above
the interval the observer is optimistic, below it pessimistic. Gaussian errors lie within 1, 2, 3 sigma with probability .683,
.954, .997.
Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.confidence_intervals import Estimate, Values
from pcbench.statistics.distributions import chi_square_exceeded

SIGMAS = (1, 2, 3)
INSIDE = tuple(f"coverage_{k}_sigma" for k in SIGMAS)
BANDS = {"nees": "nees_band", "nis": "nis_band", "signal_nees": "signal_nees_band"}
LEVEL = 0.05
ROUNDING = 1e-6  # relative, for exact values


class Band(NamedTuple):
    """Interval of the mean of normalized squares for a correct covariance."""

    low: float
    high: float


def band(degrees: float) -> Band:
    """Return the 95 % interval of chi2(degrees) / degrees."""
    low, high = (chi_square_exceeded(degrees, share) / degrees for share in (1 - LEVEL / 2, LEVEL / 2))
    return Band(low, high)


def verdict(mean: float, within: Band) -> str:
    """Return the verdict on a mean normalized square."""
    if np.isnan(mean):
        return "unknown"
    return "optimistic" if mean > within.high else "pessimistic" if mean < within.low else "consistent"


def exact_band() -> Band:
    """Return the interval of an expected normalized square for a correct covariance: 1, up to rounding."""
    return Band(1 - ROUNDING, 1 + ROUNDING)


def inside(signal: Values) -> NDArray[np.int64]:
    """Return how many normalized squares [signals, n] lie within each of SIGMAS, [3, signals]."""
    return np.stack([(signal <= k * k).sum(-1) for k in SIGMAS])


def bands(n: int, degrees: Values) -> Estimate:
    """Return the bands [K] about 1 of means over n runs of squares with these degrees of freedom."""
    intervals = [band(d * n) if n and d > 0 else Band(np.nan, np.nan) for d in degrees]
    low, high = (np.array([getattr(b, end) for b in intervals]) for end in ("low", "high"))
    return Estimate(n, np.where(np.isnan(low), np.nan, 1.0), np.full(len(intervals), np.nan), low, high)
