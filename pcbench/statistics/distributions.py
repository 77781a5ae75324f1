"""Normal, Student and chi-square distributions. SciPy is imported on first use."""

from functools import cache


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
