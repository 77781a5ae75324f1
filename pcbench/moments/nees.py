"""Exact consistency of an observer: the covariance it assumes at the last tick against its true error.

    E e' P^-1 e / n = tr(P^-1 (S + m m')) / n,   E e_i^2 / P_ii = (S_ii + m_i^2) / P_ii

with m and S the true mean and covariance of e, and P the assumed covariance. Both are 1 if P is correct. For a normal error
the share within k sigma follows. States that are known do not count. A singular P has its pseudo-inverse and rank, as in runs
(`simulation.innovation_stats`).
Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.
"""

from typing import NamedTuple

import numpy as np

from pcbench.simulation.innovation_stats import KNOWN_TOL, RANK_TOL
from pcbench.statistics.confidence_intervals import Values
from pcbench.statistics.consistency import SIGMAS


class FinalErrors(NamedTuple):
    """The errors of one observer's n states at the last tick, in S realisations."""

    mean: Values  # [n, S]
    covariance: Values  # [n, n, S]
    P: Values  # [n, n, S] assumed
    prior: Values  # [n] standard deviations


class Squares(NamedTuple):
    """Expected normalized squares, by realisation."""

    nees: Values  # [1, S] over the states that count, divided by the rank of P
    signal: Values  # [n, S], NaN for a known state
    states: Values  # [1, S] the rank


def squares(errors: FinalErrors) -> Squares:
    """Return the expected normalized squares."""
    second = errors.covariance + errors.mean[:, None] * errors.mean[None]
    nees, ranks = [], []
    for s in range(errors.P.shape[-1]):
        is_uncertain = _is_uncertain(errors)[:, s]
        block = np.ix_(is_uncertain, is_uncertain)
        trace, rank = _normalized_trace(errors.P[..., s][block], second[..., s][block])
        ranks.append(rank)
        nees.append(trace / rank if rank else np.nan)
    return Squares(np.array([nees]), _diagonal(second) / _variances(errors), np.array([ranks], float))


def _normalized_trace(P: Values, second: Values) -> tuple[float, int]:
    """Return the trace of P^+ S, and the rank of P."""
    std = np.sqrt(np.diag(P))
    size, V = np.linalg.eigh(P / np.outer(std, std))
    spans = size > RANK_TOL * size.max(initial=0.0)
    along = np.einsum("ij,ik,kj->j", V, second / np.outer(std, std), V)
    return float(np.sum(along[spans] / size[spans])), int(spans.sum())


def inside(errors: FinalErrors) -> list[Values]:
    """Return for each of SIGMAS the share [n, S] of normal errors within it; NaN for a known state."""
    from scipy.special import ndtr

    sigma, std = np.sqrt(_variances(errors)), np.sqrt(np.maximum(_diagonal(errors.covariance), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        probabilities = [[ndtr((side * k * sigma - errors.mean) / std) for side in (1, -1)] for k in SIGMAS]
    without_noise = [np.where(np.isnan(sigma), np.nan, (np.abs(errors.mean) <= k * sigma) * 1.0) for k in SIGMAS]
    pairs = zip(probabilities, without_noise, strict=True)
    return [np.where(std > 0, high - low, noise_free) for (high, low), noise_free in pairs]


def _is_uncertain(errors: FinalErrors) -> np.ndarray:
    return _diagonal(errors.P) > np.square(KNOWN_TOL * errors.prior)[:, None]


def _variances(errors: FinalErrors) -> Values:
    return np.where(_is_uncertain(errors), _diagonal(errors.P), np.nan)


def _diagonal(P: Values) -> Values:
    """Return the diagonal [n, S] of matrices [n, n, S]."""
    return np.einsum("iis->is", P)
