"""Gains of two current estimators whose combination has no error after N samples, and their combination.

With F_i = (I - L_i C) Phi, i = 1, 2, the error of each estimator is multiplied by F_i^N over N samples. Both estimate the
same state. So with K1 + K2 = I and K1 F1^N + K2 F2^N = 0, that is K2 = F1^N (F1^N - F2^N)^-1,

    xhat_m = K1 (z1_m - F1^N z1_(m-N)) + K2 (z2_m - F2^N z2_(m-N)) = K1 z1_m + K2 z2_m - H (z1_(m-N) - z2_(m-N)),   H = K1 F1^N

has no error, for all initial errors. In the source z is continuous, with exp((A - L_i C) D) instead of F_i^N. Its [K1 K2] =
[I 0] [E, exp(F D) E]^-1, F = diag(A - L1 C, A - L2 C), E = [I; I], is equivalent. For small N, K1 and K2 are large.
A mode that decays by 99 % or more per sample keeps its pole (`bandwidth`). Then H = (K1 F1^N - K2 F2^N) / 2, and the error
vanishes at the rate of that mode.

Source: Engel, Kreisselmeier, IEEE TAC 47(7), 2002, for continuous measurement; the form for samples is this project's.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.errors import DesignError
from pcbench.synthesis import bandwidth
from pcbench.synthesis.certificate import Certificate

FASTEST = 0.01  # size of a mode per sample below which it keeps its pole
MAX_WEIGHT = 1e8  # of the entries of K1, K2; above, rounding errors dominate
INEQUALITY = "radius of F1 and F2 < 1; K1 + K2 = I, K1 F1^N + K2 F2^N = 0"


class FiniteTimeGains(NamedTuple):
    """The two estimators on the first axis, the slower one first."""

    L: Matrix  # [2, n, q]
    K: Matrix  # [2, n, n] of z_m
    H: Matrix  # [n, n] of z1_(m-N) - z2_(m-N)


def weights(M1: Matrix, M2: Matrix) -> tuple[Matrix, Matrix]:
    """Return K1, K2 [n, n] with K1 + K2 = I and K1 M1 + K2 M2 = 0; raise LinAlgError for a singular M1 - M2."""
    K2 = np.asarray(np.linalg.solve((M1 - M2).T, M1.T).T, float)
    return np.eye(len(M1)) - K2, K2


def design(
    Phi: Matrix, C: Matrix, pole: float, ratio: float, N: int, where: str
) -> tuple[FiniteTimeGains, Certificate]:
    """Return gains and certificate.

    Args:
        Phi: [n, n], over a sampling period.
        C: [q, n].
        pole: of the slower estimator, per sample; the other's is pole^ratio.
        ratio: above 1.
        N: samples.
        where: what is designed, for error messages.

    Raises:
        DesignError: the poles cannot be placed, or K1 and K2 do not exist or are larger than 1e8.
    """
    I, slow = np.eye(len(Phi)), bandwidth.slow_modes(Phi, C, FASTEST)
    L = np.stack([bandwidth.current_gain(Phi, C, p, FASTEST, where) for p in (pole, pole**ratio)])
    F = (I - L @ C) @ Phi
    F_N = np.linalg.matrix_power(F, N)
    try:
        k2 = weights(*(slow.W @ F_N @ slow.V))[1]
    except np.linalg.LinAlgError:
        k2 = np.full_like(slow.Phi, np.inf)
    size = float(np.abs(k2).max(initial=0.0))
    if not size < MAX_WEIGHT:
        raise DesignError(
            f"{where}: got weights of size {size:.2g} for {N} samples, expected less than {MAX_WEIGHT:g}; use more samples or "
            "other poles."
        )
    K2 = slow.V @ k2 @ slow.W
    K = np.stack([I - K2, K2])
    radius = spectral_radius(F)
    H = (K[0] @ F_N[0] - K[1] @ F_N[1]) / 2
    numbers = {"K1": K[0], "K2": K[1], "L1": L[0], "L2": L[1], "left": float(np.abs((K @ F_N).sum(0)).max())}
    return FiniteTimeGains(L, K, H), Certificate(INEQUALITY, 1 - radius, "numpy", "computed", numbers)
