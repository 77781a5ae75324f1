"""Estimates over runs with standard error and 95 % interval, for many rows at once. NumPy and SciPy, no jax.

- `student`: mean, with Student's interval, for signed numbers. Source: Student, Biometrika 6 (1908), 1-25.
- `positive`: mean of numbers that cannot be negative, with Student's interval of its logarithm. The standard error of the
  logarithm is se / mean by the delta method. So the ends are mean exp(-+ t se / mean), and none is below 0.
- `root`: pooled rms, the root of a mean square. The interval is that of the mean square with its ends under the root (monotone,
  so the coverage is the same). The standard error is by the delta method.
- `rms_efficiency`: bound / pooled rms, likewise.
- `wilson`: a fraction. Source: Wilson, J. Am. Stat. Assoc. 22 (1927), 209-212.

Coverage (`test_coverage`) of the intervals of means, roots and efficiencies is 93.5 to 96.5 % if the metric's skewness over
runs is

- at most 1, from 8 runs on (an error's mean absolute value)
- at most 2, from 64 runs on (a mean square of two or more degrees of freedom)
- at most 3, from 64 runs on (a mean square of one degree)
- at most 6, from 1024 runs on (a log-normal of sigma 1)

Not claimed: coverage for more skewness or fewer runs. With 8 runs it is 93 % for skewness 2, 91 % for 3 and 88 % for 6; with 64
runs 92 % for 6. The intervals then mostly lie too low. Student's own interval covers less in each of these cases (8 runs of
skewness 2: 89 %) and extends below 0. Hall's cubic correction (J. R. Stat. Soc. B 54 (1992), 221-228) is within 1 % of the
logarithm's interval.

Wilson's interval covers 93.5 to 96.5 % for every fraction from .02 to .5 from 1024 runs on. With fewer runs the coverage varies
with the fraction, as counts are integers: between 93.3 and 97.3 % for 256 runs (within 93.5 to 96.5 % for 99 % of the
fractions), between 92.7 and 97.9 % for 64 (91 % of the fractions). On average over fractions it is 95 %.

Mean and sum of squares are accumulated in parts, which are merged without cancellation (Chan, Golub, LeVeque, Am. Stat. 37
(1983), 242-247):

    d = mean_b - mean_a,   mean = mean_a + d n_b / n,   m2 = m2_a + m2_b + d^2 n_a n_b / n.

A row whose values are all equal keeps that value and m2 = 0 exactly, for any parts. Merging is associative up to rounding only:
merge the same parts in the same order to get the same bits.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench.statistics.distributions import student_quantile

Values = NDArray[np.float64]


class Moments(NamedTuple):
    """Accumulated moments of values [K, n]; all fields but n are [K]."""

    n: int
    mean: Values  # 0 if n = 0
    m2: Values  # sum of (value - mean)^2
    low: Values  # smallest value; inf if n = 0
    high: Values  # largest value


def moments(values: Values) -> Moments:
    """Return the moments of the rows of values [K, n]; NaN affects only its row."""
    x = np.ascontiguousarray(values, dtype=np.float64)  # a row's sum has the same bits for any memory layout
    n = x.shape[-1]
    centre = x.sum(-1) / max(n, 1)
    difference = x - centre[:, None]
    m2 = np.square(difference, out=difference).sum(-1)
    return _exact(Moments(n, centre, m2, x.min(-1, initial=np.inf), x.max(-1, initial=-np.inf)))


def merge(a: Moments, b: Moments) -> Moments:
    """Return the merged moments of two parts [K]."""
    n = a.n + b.n
    d, share = b.mean - a.mean, b.n / max(n, 1)
    m2 = a.m2 + b.m2 + d * d * (a.n * share)
    return _exact(Moments(n, a.mean + d * share, m2, np.minimum(a.low, b.low), np.maximum(a.high, b.high)))


def _exact(m: Moments) -> Moments:
    """Return moments in which rows that do not vary have no rounding error."""
    is_constant = m.low == m.high
    return m._replace(mean=np.where(is_constant, m.low, m.mean), m2=np.where(is_constant, 0.0, m.m2))


Z95 = 1.959963984540054  # quantile of the normal distribution


class Estimate(NamedTuple):
    """Estimates [K] over n runs; NaN if there are too few."""

    n: int
    mean: Values
    se: Values
    ci_low: Values
    ci_high: Values


def student(m: Moments) -> Estimate:
    """Return the means with Student's 95 % interval; no width if the runs do not vary."""
    blank = np.full(m.mean.shape, np.nan)
    if m.n < 2:
        return Estimate(m.n, m.mean if m.n else blank, blank, blank, blank)
    se = np.sqrt(m.m2 / (m.n - 1)) / np.sqrt(m.n)
    half = se * student_quantile(m.n - 1, 0.975)
    return Estimate(m.n, m.mean, se, m.mean - half, m.mean + half)


def positive(m: Moments) -> Estimate:
    """Return the means of numbers that cannot be negative, with Student's 95 % interval of their logarithm."""
    e = student(m)
    if m.n < 2:
        return e
    relative_half = e.se * student_quantile(m.n - 1, 0.975) / np.where(e.mean > 0, e.mean, 1.0)
    with np.errstate(over="ignore"):  # for the mean of a signed metric, which uses Student's interval
        return e._replace(ci_low=e.mean * np.exp(-relative_half), ci_high=e.mean * np.exp(relative_half))


def root(squares: Estimate) -> Estimate:
    """Return the roots of mean squares."""
    with np.errstate(invalid="ignore"):  # for exact moments without digits, which are refused
        centre, low, high = np.sqrt(squares.mean), np.sqrt(squares.ci_low), np.sqrt(squares.ci_high)
    se = np.where(centre > 0, squares.se / (2 * np.where(centre > 0, centre, 1.0)), squares.se)
    return Estimate(squares.n, centre, se, low, high)


def rms_efficiency(bound: Values, pooled_rmse: Estimate) -> Estimate:
    """Return bound [K] / pooled rms; NaN if the rms (or an end of its interval) or the bound is zero."""

    def over(rms: Values) -> Values:
        return np.where((rms > 0) & (bound > 0), bound / np.where(rms > 0, rms, 1.0), np.nan)

    value = over(pooled_rmse.mean)
    se = value * pooled_rmse.se / np.where(pooled_rmse.mean > 0, pooled_rmse.mean, 1.0)
    return Estimate(pooled_rmse.n, value, se, over(pooled_rmse.ci_high), over(pooled_rmse.ci_low))


def wilson(count: NDArray[np.int64], n: int) -> Estimate:
    """Return count [K] / n, a fraction of runs, with Wilson's 95 % interval."""
    if not n:
        blank = np.full(np.shape(count), np.nan)
        return Estimate(0, blank, blank, blank, blank)
    p, z2 = np.asarray(count) / n, Z95**2
    centre, half = p + z2 / (2 * n), Z95 * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    low = np.where(p > 0, (centre - half) / (1 + z2 / n), 0.0)
    high = np.where(p < 1, (centre + half) / (1 + z2 / n), 1.0)
    return Estimate(n, p, np.sqrt(p * (1 - p) / n), low, high)
