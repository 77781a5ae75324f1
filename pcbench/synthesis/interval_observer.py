"""Gain and coordinates of an interval observer, whose error is bounded for all noise within given bounds.

The error before a sample is used obeys e(k+1) = M e(k) + b w - K v with M = Phi - K C, K = Phi L, |w| <= wmax, |v| <= vmax.
With real distinct eigenvalues l, M = V diag(l) V^-1,

    r(k+1) = |l| r(k) + |V^-1 b| wmax + |V^-1 K| vmax,     |V^-1 e| <= r,     x in xhat +- |V| r

Proof: V^-1 e(k+1) = diag(l) V^-1 e(k) + V^-1 b w - V^-1 K v; take absolute values, entry by entry. The same holds for any V,
with |N| = |V^-1 M V| instead of |l|, and r stays bounded if the spectral radius of |N| is below 1: the certificate. So complex
eigenvalues are allowed too, with the real and the imaginary part of its eigenvector in V.
Source: this project's, after Mazenc, Dinh, Automatica 50(10), 2014, which was not obtained.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.errors import DesignError
from pcbench.synthesis import bandwidth
from pcbench.synthesis.certificate import Certificate, require_certified
from pcbench.value_cache import cached_by_value

INEQUALITY = "radius of |V^-1 M V| < 1, M = Phi (I - L C), V its real modes"
FASTEST = 1e-3  # size of a mode per sample below which it keeps its pole
MAX_CONDITION = 1e6  # condition number of V, with columns and rows of one size


class IntervalGains(NamedTuple):
    """The gain and the coordinates of the radius; n states, q outputs."""

    L: Matrix  # [n, q]
    V: Matrix  # [n, n]
    V_inv: Matrix  # [n, n]


def gain(Phi: Matrix, C: Matrix, pole: float, poles: list[float] | None, where: str) -> Matrix:
    """Return L [n, q] with real distinct poles of Phi (I - L C): `poles`, or `pole` and equally spaced smaller ones.

    With `pole`, modes that decay faster than 1e-3 per sample keep theirs. Raises DesignError if the poles cannot be placed.
    """
    slow = bandwidth.slow_modes(Phi, C, 0.0 if poles else FASTEST)
    k = len(slow.Phi)
    target_poles = np.array(poles) if poles else pole * np.arange(k, 0, -1) / max(k, 1)
    # (I - L C) Phi has the poles of M
    return slow.V @ bandwidth.predictor_gain(slow.Phi, slow.C @ slow.Phi, target_poles, where)


def certify(Phi: Matrix, C: Matrix, L: Matrix, where: str) -> tuple[IntervalGains, Certificate]:
    """Return a gain with the modes of M = Phi (I - L C), and its certificate.

    Args:
        Phi: [n, n], over a sampling period.
        C: [q, n].
        L: [n, q], of the correction at a sample's time.
        where: what is designed, for error messages.

    Raises:
        DesignError: M has no basis of modes, or r would grow.
    """
    M = Phi @ (np.eye(len(Phi)) - L @ C)
    l, modes = np.linalg.eig(M)
    V = np.where(l.imag < 0, modes.imag, modes.real)
    rows = np.abs(V).max(1, keepdims=True)
    if not np.linalg.cond(V / np.where(rows > 0, rows, 1.0)) < MAX_CONDITION:
        raise DesignError(
            f"{where}: got a gain with the poles {np.round(np.sort_complex(l), 6).tolist()} per sample, expected distinct "
            "ones; give another gain or other poles."
        )
    V_inv = np.asarray(np.linalg.inv(V), float)
    N = np.abs(V_inv @ M @ V)
    margin = 1 - spectral_radius(N)
    certificate = Certificate(INEQUALITY, margin, "numpy", "computed", {"L": L, "V": V, "N": N})
    return IntervalGains(L, np.asarray(V, float), V_inv), require_certified(certificate, where)


@cached_by_value
def accumulate_noise(Phi: Matrix, columns: Matrix, V_inv: Matrix, ticks: int) -> Matrix:
    """Return what process noise adds to r over s = 0 .. ticks ticks, [ticks + 1, n]: the sum of |V^-1 Phi^i b| over i < s.

    Args:
        Phi: [n, n], over a tick.
        columns: [n, k] b, each multiplied by the bound of its noise per tick.
        V_inv: [n, n] V^-1.
        ticks: the largest s.
    """
    out, b = np.zeros((ticks + 1, len(Phi))), columns
    with np.errstate(over="ignore", invalid="ignore"):  # overflow of an unstable plant at ages that do not occur
        for s in range(ticks if columns.any() else 0):
            out[s + 1] = out[s] + np.abs(V_inv @ b).sum(1)
            b = Phi @ b
    return out


def final_width(gains: IntervalGains, Phi: Matrix, C: Matrix, noise: Matrix, vmax: Matrix) -> Matrix:
    """Return the width of the interval of each state [n] after many samples, before the next is used.

    Args:
        gains: the gain with its modes.
        Phi: [n, n], over a sampling period.
        C: [q, n].
        noise: [n], what process noise adds to r over a sampling period.
        vmax: [q].
    """
    K = Phi @ gains.L
    N, rhs = np.abs(gains.V_inv @ (Phi - K @ C) @ gains.V), noise + np.abs(gains.V_inv @ K) @ vmax
    return np.asarray(2 * np.abs(gains.V) @ np.linalg.solve(np.eye(len(N)) - N, rhs))
