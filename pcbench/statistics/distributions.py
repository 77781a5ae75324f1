"""Normal, Student, binomial, chi-square distributions. SciPy is imported by who asks first; quantiles are found once."""

from functools import cache
from typing import Any

from numpy.typing import NDArray


def normal_below(x: NDArray[Any]) -> NDArray[Any]:
    """Return P(X <= x) of the standard normal distribution."""
    from scipy.special import ndtr

    return ndtr(x)


@cache
def normal_quantile(p: float) -> float:
    """Return the x below which a standard normal number lies with probability p."""
    from scipy.special import ndtri

    return float(ndtri(p))


def student_below(df: int, t: NDArray[Any]) -> NDArray[Any]:
    """Return P(T <= t) of Student's t with `df` degrees of freedom."""
    from scipy.special import stdtr

    return stdtr(df, t)


@cache
def student_quantile(df: int, p: float) -> float:
    """Return the t below which Student's t lies with probability p."""
    from scipy.special import stdtrit

    return float(stdtrit(df, p))


def binomial_above(k: Any, n: int, q: Any) -> NDArray[Any]:
    """Return P(N > k) of N successes in n trials that succeed with probability q each."""
    from scipy.special import bdtrc

    return bdtrc(k, n, q)


@cache
def chi_square_exceeded(degrees: float, share: float) -> float:
    """Return what a chi-square number of so many degrees of freedom exceeds with this probability."""
    from scipy.special import chdtri

    return float(chdtri(degrees, share))


def chi_square_share(degrees: float, x: float) -> float:
    """Return with which probability a chi-square number of so many degrees of freedom exceeds x."""
    from scipy.special import chdtrc

    return float(chdtrc(degrees, x))
