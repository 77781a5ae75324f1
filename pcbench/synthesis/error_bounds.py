"""Bounds that a gain guarantees: the decay rate over every interval, and the effect of noise on the estimate.

The error of a current estimator after a sample was used, e = x - xhat, obeys

    e_m = F e_(m-1) + (I - L C) w_m - L v_m,   F = (I - L C) Phi,   w ~ (0, Q), v ~ (0, R)

All bounds are computed in NumPy from the gain itself, whatever its design method. For a range of maps, one P (or X) holds for
all of them.
"""

import math

import numpy as np
from scipy.linalg import eigh

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.errors import UserError

ZERO_EXPONENT = 12.0  # an error that decays by e^-12 counts as zero
NO_BOUND = 1e300  # no bound
DOUBLINGS = 60  # of the number of terms in a sum; enough for a spectral radius of 1 - 1e-16
MIN_FACTOR = 1e-150  # least factor e^{-rate T}, so that deadbeat errors have a finite rate


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
    return float((-np.log(np.maximum(factors, MIN_FACTOR)) / seconds).min())


def require_slower(rate: float, seconds: Matrix, where: str) -> None:
    """Raise UserError for a rate [1/s] at which an error decays below e^-12 within some interval [s]."""
    limit = ZERO_EXPONENT / float(np.max(seconds))
    if rate > limit:
        raise UserError(
            f"{where}: got a decay of {rate:g} 1/s, expected {limit:.3g} at most over intervals of {np.max(seconds):g} s, "
            "within which faster errors vanish; use a slower one."
        )


def rate_of(factor: float, seconds: float) -> float:
    """Return the decay rate [1/s] of errors that are multiplied by `factor` every `seconds`."""
    return -math.log(max(factor, MIN_FACTOR)) / seconds


def noise(L: Matrix, C: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """Return the covariance that one sample adds to the error, [k, n, n] for Q [k, n, n]."""
    I_LC = np.eye(len(L)) - L @ C
    return np.asarray(I_LC @ Q @ I_LC.T + L @ R @ L.T)


def covariance(F: Matrix, N: Matrix) -> Matrix:
    """Return the stationary X = F X F' + N [n, n]; NaN if F [n, n] is not stable.

    X is the sum of F^k N F'^k, added by doubling. A sum of positive terms is accurate in all units of the states, while a
    linear system for X is ill-conditioned in some.
    """
    if not spectral_radius(F) < 1:
        return np.full_like(F, np.nan)
    X, power = np.asarray(N, dtype=np.float64), F
    for _ in range(DOUBLINGS):
        term = power @ X @ power.T
        X, power = X + term, power @ power
        if (np.abs(term) <= np.finfo(float).eps * np.abs(X)).all():
            break
    return X


def bound(F: Matrix, N: Matrix, P: Matrix) -> Matrix:
    """Return X = s inv(P) with X >= F X F' + N at every map, which bounds the covariance for every order of the maps.

    The result is NaN if P gives no bound.
    """
    X = np.linalg.inv(P)
    try:
        U = np.linalg.inv(np.linalg.cholesky(X - F @ X @ F.transpose(0, 2, 1)))
        s = float(np.linalg.eigvalsh(U @ N @ U.transpose(0, 2, 1)).max())
    except np.linalg.LinAlgError:
        return np.full_like(P, np.nan)
    return np.asarray(s * X, dtype=np.float64)


def gain_bound(F: Matrix, B: Matrix, W: Matrix, P: Matrix) -> float:
    """Return the least g with sum |W e|^2 <= g^2 sum |d|^2, e = F e + B d, by e'(s P) e for any s > 0.

    F [k, n, n], B [k, n, d]; NaN if P gives no bound. Over one map g is a bound of the H-infinity norm.
    """
    Ft, Bt = F.transpose(0, 2, 1), B.transpose(0, 2, 1)

    from scipy.optimize import minimize_scalar  # takes a tenth of a second to import

    def square(exponent: float) -> float:
        S = np.exp(exponent) * P
        slack = S - W.T @ W - Ft @ S @ F
        if not np.linalg.eigvalsh(slack).min() > 0:
            return NO_BOUND
        cross = Ft @ S @ B
        return float(np.linalg.eigvalsh(Bt @ S @ B + cross.transpose(0, 2, 1) @ np.linalg.solve(slack, cross)).max())

    if not (np.isfinite(P).all() and np.linalg.eigvalsh(P)[0] > 0):
        return float("nan")
    start = np.log(float(eigh(W.T @ W, P, eigvals_only=True)[-1]))
    minimum = minimize_scalar(square, bounds=(start - 1, start + 12), method="bounded", options={"xatol": 1e-9})
    return float(np.sqrt(minimum.fun)) if minimum.fun < NO_BOUND else float("nan")
