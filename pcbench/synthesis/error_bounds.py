"""What a gain promises: a rate of decay over every interval, and how much noise reaches the estimate.

Errors of a current estimator, e = x - xhat at the time of a sample, after it was used:

    e_m = F e_(m-1) + (I - L C) w_m - L v_m,   F = (I - L C) Phi,   w ~ (0, Q), v ~ (0, R)

All are computed from the gain itself in NumPy, whoever found it. Where a range of maps is given, one P (or X) serves them all.
"""

import math

import numpy as np
from scipy.linalg import eigh

from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError

GONE = 12.0  # e^-12 over an interval is as good as nothing
NONE = 1e300  # stands for no bound at all
DOUBLINGS = 60  # of the number of terms in a sum: enough for a spectral radius of 1 - 1e-16
LEAST = 1e-150  # of a factor e^{-rate T}: an error that vanishes at once


def errors(L: Matrix, C: Matrix, Phi: Matrix) -> Matrix:
    """Return F [k, n, n] for maps Phi [k, n, n]."""
    return np.asarray((np.eye(Phi.shape[-1]) - L @ C) @ Phi)


def rate(F: Matrix, P: Matrix, seconds: Matrix) -> float:
    """Return the largest rate [1/s] with F'P F <= e^{-2 rate T} P at every map F [k, n, n] over T [k]; NaN unless P > 0."""
    try:
        U = np.linalg.cholesky(P).T  # |e|_P = |U e|
    except np.linalg.LinAlgError:
        return float("nan")
    factors = np.linalg.norm(U @ F @ np.linalg.inv(U), 2, axis=(1, 2))
    return float((-np.log(np.maximum(factors, LEAST)) / seconds).min())


def require_slower(rate: float, seconds: Matrix, where: str) -> None:
    """Raise UserError where a rate [1/s] is so fast that an error would be gone within some interval [s]."""
    most = GONE / float(np.max(seconds))
    if rate > most:
        raise UserError(
            f"{where}: got a decay of {rate:g} 1/s, expected {most:.3g} at most over intervals of {np.max(seconds):g} s, "
            "within which faster errors are gone; ask for a slower one."
        )


def rate_of(factor: float, seconds: float) -> float:
    """Return the rate [1/s] of errors that a spectral radius or norm multiplies every so many seconds."""
    return -math.log(max(factor, LEAST)) / seconds


def noise(L: Matrix, C: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """Return the covariance that one sample adds to the error, [k, n, n] for Q [k, n, n]."""
    keep = np.eye(len(L)) - L @ C
    return np.asarray(keep @ Q @ keep.T + L @ R @ L.T)


def covariance(F: Matrix, N: Matrix) -> Matrix:
    """Return the stationary X = F X F' + N [n, n]; NaN if F [n, n] is not stable.

    X is the sum of F^k N F'^k, added by doubling: a sum of positive terms keeps its digits whatever the units of the states,
    for which a linear system in X is ill-conditioned.
    """
    if not np.abs(np.linalg.eigvals(F)).max() < 1:
        return np.full_like(F, np.nan)
    X, power = np.asarray(N, dtype=np.float64), F
    for _ in range(DOUBLINGS):
        more = power @ X @ power.T
        X, power = X + more, power @ power
        if (np.abs(more) <= np.finfo(float).eps * np.abs(X)).all():
            break
    return X


def bound(F: Matrix, N: Matrix, P: Matrix) -> Matrix:
    """Return X = s inv(P) with X >= F X F' + N at every map: no covariance exceeds it, in whatever order the maps come.

    NaN where P proves none.
    """
    X = np.linalg.inv(P)
    try:
        U = np.linalg.inv(np.linalg.cholesky(X - F @ X @ F.transpose(0, 2, 1)))
        s = float(np.linalg.eigvalsh(U @ N @ U.transpose(0, 2, 1)).max())
    except np.linalg.LinAlgError:
        return np.full_like(P, np.nan)
    return np.asarray(s * X, dtype=np.float64)


def gain_bound(F: Matrix, B: Matrix, W: Matrix, P: Matrix) -> float:
    """Return the least g that P proves with sum |W e|^2 <= g^2 sum |d|^2, e = F e + B d, by e'(s P) e for any s > 0.

    F [k, n, n], B [k, n, d]; NaN where it proves none. Over one map it is a bound of the H-infinity norm.
    """
    Ft, Bt = F.transpose(0, 2, 1), B.transpose(0, 2, 1)

    from scipy.optimize import minimize_scalar  # takes a tenth of a second to import

    def square(exponent: float) -> float:
        S = np.exp(exponent) * P
        room = S - W.T @ W - Ft @ S @ F
        if not np.linalg.eigvalsh(room).min() > 0:
            return NONE
        back = Ft @ S @ B
        return float(np.linalg.eigvalsh(Bt @ S @ B + back.transpose(0, 2, 1) @ np.linalg.solve(room, back)).max())

    if not (np.isfinite(P).all() and np.linalg.eigvalsh(P)[0] > 0):
        return float("nan")
    start = np.log(float(eigh(W.T @ W, P, eigvals_only=True)[-1]))
    found = minimize_scalar(square, bounds=(start - 1, start + 12), method="bounded", options={"xatol": 1e-9})
    return float(np.sqrt(found.fun)) if found.fun < NONE else float("nan")
