"""Gains of cascade predictors, and the exact map of their errors.

Link j of m predicts over d ticks, and compares its output of d ticks ago with a reference whose error is r:

    e(k+1) = Phi e(k) - K (C e(k-d) - r(k)),   the poles of Phi - K C by `bandwidth`

The reference is the preceding link. For the first link, it is the output predicted between samples, r(k+1) = r(k) + C (Phi -
I) e(k-d), with r = 0 when a sample arrives. So the first link is a periodic map over one sampling period, and the others are
maps over one tick. The errors decay if and only if the spectral radius of each map is below 1. For a scalar plant x' = a x
with continuous measurement, such a gain exists if and only if a d < 1 (d in seconds); more links make d smaller.

Source: Germani, Manes, Pepe, IEEE TAC 47(1), 2002 (cascade); the maps are this project's.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.errors import DesignError
from pcbench.synthesis import bandwidth
from pcbench.synthesis.certificate import Certificate
from pcbench.value_cache import cached_by_value

MAX_LINKS = 12  # largest default number of links
DENSE = 300  # rows of a map from which on the largest eigenvalue alone is computed
INEQUALITY = "radius of the links' error maps over one sampling period < 1"


class Links(NamedTuple):
    """The links from the delayed output to the present."""

    d: tuple[int, ...]  # ticks of each
    K: Matrix  # [n, q], the same for all


def divide(delay: int, m: int) -> tuple[int, ...]:
    """Return m whole numbers of sum `delay` [ticks] that differ by at most 1."""
    return tuple(delay * (j + 1) // m - delay * j // m for j in range(m))


def gain(Phi: Matrix, C: Matrix, decay: float, where: str) -> Matrix:
    """Return K [n, q] of a link whose errors would decay by the factor `decay` per tick without delay."""
    slow = bandwidth.slow_modes(Phi, C, decay)
    k = len(slow.Phi)
    poles = decay ** (1 + 0.2 * np.arange(k) / max(k, 1) * (len(C) > 1))
    return slow.V @ bandwidth.predictor_gain(slow.Phi, slow.C, poles, where)


@cached_by_value
def radius(Phi: Matrix, C: Matrix, K: Matrix, d: int, period: int) -> float:
    """Return the spectral radius of a link's errors over `period` ticks; 0: over one tick, for a link after the first.

    The state is [e(k), e(k-1), .., e(k-d), r(k)]. All columns of its map are computed together.
    """
    n, q = len(Phi), len(C)
    size, steps = n * (d + 1) + q, period or d + 1
    state = np.eye(size)
    past = [state[n * i : n * (i + 1)] for i in range(d, -1, -1)]  # e(k-d), .., e(k)
    r = state[size - q :] if period else np.zeros((q, size))
    for k in range(steps):
        output = C @ past[k]
        past.append(Phi @ past[-1] - K @ (output - r))
        r = r + (C @ Phi - C) @ past[k] if period else r
    F = np.vstack([*past[: -d - 2 : -1], np.zeros((q, size))])  # a sample arrives: r = 0
    largest = _largest(F[: size - q, : size - q])
    return float(largest if period else largest ** (1 / steps))


def _largest(F: Matrix) -> float:
    """Return the spectral radius; for a large matrix by Arnoldi iteration, because its other eigenvalues are much smaller."""
    if len(F) > DENSE:
        from scipy.sparse.linalg import ArpackError, eigs  # takes a while to import

        try:
            return float(np.abs(eigs(F, k=6, ncv=60, v0=np.ones(len(F)), return_eigenvectors=False)).max())
        except ArpackError:
            pass
    return spectral_radius(F)


def certify(Phi: Matrix, C: Matrix, links: Links, period: int) -> Certificate:
    """Return the certificate, whose margin is 1 minus the largest factor of the links' errors over a sampling period."""
    first = radius(Phi, C, links.K, links.d[0], period)
    other_radii = {d: radius(Phi, C, links.K, d, 0) ** period for d in set(links.d[1:])}
    numbers = {
        "links": len(links.d),
        "radius_of_first_link": first,
        "radius_of_others": max(other_radii.values(), default=0.0),
    }
    return Certificate(INEQUALITY, 1 - max(first, *other_radii.values(), 0.0), "numpy", "computed", numbers)


def design(
    Phi: Matrix, C: Matrix, delay: int, period: int, m: int | None, decay: float | None, where: str
) -> tuple[Links, Certificate]:
    """Return the links and their certificate.

    Args:
        Phi: [n, n], one tick.
        C: [q, n].
        delay: of every channel [ticks].
        period: of the samples [ticks].
        m: number of links; None: the least that is certified.
        decay: of the errors per tick if there were no delay; None: by the longest link and the period.
        where: what is designed, for error messages.

    Raises:
        DesignError: no number of links that was tried is certified.
    """
    counts = range(1, min(MAX_LINKS, max(delay, 1)) + 1) if m is None else [m]
    for count in counts:
        time_constant = max(3.0 * max(divide(delay, count)), 1.5 * period)
        K = gain(Phi, C, np.exp(-1 / time_constant) if decay is None else decay, where)
        links = Links(divide(delay, count), K)
        certificate = certify(Phi, C, links, period)
        if certificate.margin > 0:
            return links, certificate
    raise DesignError(
        f"{where}: got errors that do not decay with {'up to ' if m is None else ''}{max(counts)} links over a delay of "
        f"{delay} ticks, expected a radius below 1; use another omega, more links, or kf."
    )
