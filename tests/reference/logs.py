"""What can be known of a filter on a log, without a filter: all samples are a joint normal, conditioned; and loops.

Samples are `linear.Sample`-like: taken, arrival, channel, value.
"""

import numpy as np
from scipy.stats import chi2

from .late import Plant
from .surprise import joint


def smoothed(model, u, samples, xhat0, P0, R, W):
    """Return the mean [N+1, n] of the state at every tick given all samples, those to come too."""
    plant = Plant(model, u, W)
    mean, S = joint(plant, samples, xhat0, P0, R)
    left = np.linalg.solve(S, np.array([s.value for s in samples]) - mean)
    spread = [plant.powers[k] @ P0 @ plant.powers[k].T + plant.noise(k) for k in range(len(u))]
    out = []
    for k in range(len(u)):
        across = []
        for s in samples:
            C = plant.C[s.channel]
            if s.taken >= k:
                across.append(C @ plant.powers[s.taken - k] @ spread[k])
            else:
                across.append(C @ (plant.powers[k - s.taken] @ spread[s.taken]).T)
        out.append(plant.state(np.asarray(xhat0, float), 0, k) + np.array(across).T @ left)
    return np.array(out)


def ljung_box(z, lags):
    """Return Q and its p-value of a sequence whose mean is 0."""
    T, Q = len(z), 0.0
    for h in range(1, lags + 1):
        r = sum(z[i] * z[i - h] for i in range(h, T)) / sum(each**2 for each in z)
        Q += T * (T + 2) * r**2 / (T - h)
    return Q, chi2(lags).sf(Q)


def kalman(A, B, Q, C, R, x, P, u, y):
    """Return nu and s of each sample of a scalar output y [N] (NaN: none), by the book's recursion."""
    nu, s = [], []
    for k in range(len(y)):
        if not np.isnan(y[k]):
            nu.append(y[k] - (C @ x).item())
            s.append((C @ P @ C.T).item() + R)
            K = P @ C.T / s[-1]
            x, P = x + K[:, 0] * nu[-1], P - K @ C @ P
        x, P = A @ x + B @ u[k], A @ P @ A.T + Q
    return np.array(nu), np.array(s)


def delays(rows):
    """How many rows (sampled, arrived) of one channel are out of order and doubled, by comparing each with all before it."""
    stamps = [sampled for sampled, _ in rows]
    behind = sum(any(earlier > stamp for earlier in stamps[:i]) for i, stamp in enumerate(stamps))
    doubled = len(stamps) - len(set(stamps))
    return behind, doubled
