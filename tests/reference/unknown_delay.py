"""Filters that look for the delay of their samples, the long way: every sample of every filter again at every arrival.

Plant x' = A x + B u under held u, ticks of h; y = C x + v; samples come, all of one delay that nobody knows.
`bank`: for each delay a textbook filter whose samples are of arrival - delay (0 at least); the mixture of them.
`ekf_delay`: state of L ticks ago and delay; the sample's time between ticks by a straight line, slopes by matrix powers.
"""

import numpy as np
from numpy.linalg import matrix_power

from .linear import Model, discretise


def moved(Ad, Bd, u, x, start, stop):
    """The state at tick `stop` from that at tick `start`."""
    for k in range(start, stop):
        x = Ad @ x + Bd @ u[k]
    return x


def grown(Ad, Q, P, ticks):
    """The covariance so many ticks on."""
    for _ in range(ticks):
        P = Ad @ P @ Ad.T + Q
    return P


def bank(model: Model, u, samples, xhat0, P0, R, Q, delays, mean, std):
    """Return per tick (xhat [n], delay [s]) and, at the last tick, the covariance of both; `samples`: (arrival, y [q])."""
    Ad, Bd = discretise(model.A, model.B, model.h)
    N, h, n = len(u) - 1, model.h, len(Ad)
    out, P_end = [], None
    for k in range(N + 1):
        z, w, Ps = [], [], []
        for d in delays:
            x, P, at, log = np.array(xhat0, float), np.array(P0, float), 0, -0.5 * ((d * h - mean) / std) ** 2
            for arrival, y in samples:
                if arrival > k:
                    break
                taken = max(arrival - d, 0)
                x, P, at = moved(Ad, Bd, u, x, at, taken), grown(Ad, Q, P, taken - at), taken
                S = model.C @ P @ model.C.T + np.diag(R)
                nu = y - model.C @ x
                log -= 0.5 * (nu @ np.linalg.solve(S, nu) + np.log(np.linalg.det(S)))
                K = P @ model.C.T @ np.linalg.inv(S)
                x, P = x + K @ nu, P - K @ S @ K.T
            z.append(np.append(moved(Ad, Bd, u, x, at, k), d * h))
            Ps.append(grown(Ad, Q, P, k - at))
            w.append(log)
        share = np.exp(np.array(w) - np.max(w))
        share /= share.sum()
        z = np.array(z)
        out.append(share @ z)
        P_end = sum(s * np.outer(each - out[-1], each - out[-1]) for s, each in zip(share, z, strict=True))
        P_end[:n, :n] += sum(s * P for s, P in zip(share, Ps, strict=True))
    return np.array(out), P_end


def ekf_delay(model: Model, u, samples, xhat0, P0, R, Q, mean, std, longest, walk):
    """Return per tick (xhat [n], delay [s]); `longest` [ticks], `walk` [s^2] a tick."""
    Ad, Bd = discretise(model.A, model.B, model.h)
    N, h, n = len(u) - 1, model.h, len(Ad)
    A2, Q2 = np.eye(n + 1), np.zeros((n + 1, n + 1))
    A2[:n, :n], Q2[:n, :n], Q2[n, n] = Ad, Q, walk
    z, P, base, out, arriving = np.append(xhat0, mean), np.zeros((n + 1, n + 1)), 0, [], dict(samples)
    P[:n, :n], P[n, n] = P0, std**2
    xhat = np.array(xhat0, float)
    for k in range(N + 1):
        if k in arriving:
            new = max(k - longest, 0)
            z = np.append(moved(Ad, Bd, u, z[:n], base, new), z[n])
            P, base = grown(A2, Q2, P, new - base), new
            place = min(max(k - z[n] / h, base), k)
            i = min(max(int(np.floor(place)), base), max(k - 1, base))
            part = place - i
            a = moved(Ad, Bd, u, z[:n], base, i)
            b = moved(Ad, Bd, u, a, i, i + 1) if i < k else a
            Fa = matrix_power(Ad, i - base)
            Fb = Ad @ Fa if i < k else Fa
            H = np.column_stack([model.C @ ((1 - part) * Fa + part * Fb), -(model.C @ (b - a)) / h])
            S = H @ P @ H.T + np.diag(R)
            K = P @ H.T @ np.linalg.inv(S)
            z = z + K @ (arriving[k] - model.C @ ((1 - part) * a + part * b))
            P = P - K @ S @ K.T
            z[n] = min(max(z[n], 0.0), longest * h)
            xhat = moved(Ad, Bd, u, z[:n], base, k)
        out.append(np.append(xhat, z[n]))
        if k < N:
            xhat = Ad @ xhat + Bd @ u[k]
    return np.array(out)
