"""Exact discretisation of x' = A x + B u under a held input, and of the noise that drives it.

Doublings: entry b belongs to 2^b ticks. Noise over 2^b ticks follows by Q_2b = E_b Q_b E_b' + Q_b from one short tick,
never by one matrix exponential over a long interval, which overflows silently (Van Loan's at 0.6 s on the cart).
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Matrix = NDArray[np.float64]


class Model(NamedTuple):
    """A linear model with a held input: x' = A x + B u, y = C x."""

    A: Matrix  # [n, n] 1/s
    B: Matrix  # [n, m]
    C: Matrix  # [q, n]


def held(A: Matrix, B: Matrix, h: float) -> tuple[Matrix, Matrix]:
    """Return Phi = e^{A h} and Gamma = int_0^h e^{A s} ds B, exact for an input held over h seconds; A may be singular."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    whole = expm(block * h)
    return whole[:n, :n], whole[:n, n:]


def bits_for(ticks: int) -> int:
    """Return how many doublings reach every age up to `ticks`."""
    return max(int(ticks).bit_length(), 1)


def doublings(A: Matrix, h: float, bits: int) -> Matrix:
    """Return e^{A h 2^b} for b = 0 .. bits - 1, as [bits, n, n]; remembered, as every cell of a study asks for the same."""
    return _doublings(np.ascontiguousarray(A, float).tobytes(), len(A), h, bits)


@lru_cache(maxsize=256)
def _doublings(A: bytes, n: int, h: float, bits: int) -> Matrix:
    out = np.stack([expm(np.frombuffer(A).reshape(n, n) * (h * 2**b)) for b in range(bits)])
    out.flags.writeable = False
    return out


def noise_over_tick(A: Matrix, Qc: Matrix, h: float) -> Matrix:
    """Return int_0^h e^{As} Qc e^{A's} ds for one (short) tick, by Van Loan's exponential; Qc is an intensity, per second.

    Source: Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23 (1978).
    """
    n = A.shape[0]
    block = np.block([[-A, Qc], [np.zeros((n, n)), A.T]]) * h
    whole = expm(block)
    Q = whole[n:, n:].T @ whole[:n, n:]
    return (Q + Q.T) / 2


def noise_doublings(A: Matrix, Qc: Matrix, h: float, bits: int) -> Matrix:
    """Return the process noise covariance over 2^b ticks for b = 0 .. bits - 1, as [bits, n, n]."""
    E = doublings(A, h, bits)
    out = [noise_over_tick(A, Qc, h)]
    for b in range(bits - 1):
        out.append(E[b] @ out[-1] @ E[b].T + out[-1])
    return np.stack(out)


def over(doubled: Matrix, ticks: int) -> Matrix:
    """Return e^{A h ticks} as the product of its doublings."""
    E = np.eye(doubled.shape[1])
    for b in range(doubled.shape[0]):
        if ticks >> b & 1:
            E = doubled[b] @ E
    return E
