"""Filters that look for the delay of their samples, the long way: every sample of every filter again at every arrival.

Plant x' = A x + B u under held u, ticks of h; y = C x + v; samples come late, how late in the mean nobody knows.
`mmae-delay`: for each delay a textbook filter of all samples at hand in the order they were taken; the mixture of them.
`ekf_delay`: state of L ticks ago and delay; the sample's time between ticks by a straight line, slopes by matrix powers.
Samples are those of `linear`, one for each channel; of their age both read by how much it differs from an assumed mean.
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


def due(s, assumed):
    """When a sample would have come, had it been as late as the mean; of one stamped 0 nobody knows whether it is older."""
    return s.taken + assumed if s.taken else min(s.arrival, assumed)


def bank(model: Model, u, samples, xhat0, P0, R, Q, delays, mean, std, assumed):
    """Return per tick (xhat [n], delay [s]) and, at the last tick, the covariance of both; `samples` those that arrive.

    `assumed` [ticks]: the mean age by which the observer knows how much older than that a sample is.
    """
    Ad, Bd = discretise(model.A, model.B, model.h)
    N, h, n = len(u) - 1, model.h, len(Ad)
    in_order = sorted(samples, key=lambda s: (s.taken, s.arrival, s.channel))
    out, P_end = [], None
    for k in range(N + 1):
        z, w, Ps = [], [], []
        for d in delays:
            x, P, at, log = np.array(xhat0, float), np.array(P0, float), 0, -0.5 * ((d * h - mean) / std) ** 2
            for s in in_order:
                if s.arrival > k:
                    continue
                taken = max(min(due(s, assumed) - d, s.arrival), at)
                x, P, at = moved(Ad, Bd, u, x, at, taken), grown(Ad, Q, P, taken - at), taken
                c, r = model.C[s.channel], R[s.channel]
                S, nu = c @ P @ c + r, s.value - c @ x
                log -= 0.5 * (nu * nu / S + np.log(S))
                K = P @ c / S
                x, P = x + K * nu, P - np.outer(K, K) * S
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


def instants(samples, k):
    """What arrives at tick k: for each tick of sampling, oldest first, (one of them, channels, values)."""
    here = [s for s in samples if s.arrival == k]
    for taken in sorted({s.taken for s in here}):
        group = sorted((s for s in here if s.taken == taken), key=lambda s: s.channel)
        yield group[0], [s.channel for s in group], np.array([s.value for s in group])


def ekf_delay(model: Model, u, samples, xhat0, P0, R, Q, mean, std, longest, walk, assumed, later=0):
    """Return per tick (xhat [n], delay [s]); `longest`, `assumed` and `later` [ticks], `walk` [s^2] a tick.

    `assumed` is the mean age, `later` by how much the oldest sample is older than that.
    """
    Ad, Bd = discretise(model.A, model.B, model.h)
    N, h, n = len(u) - 1, model.h, len(Ad)
    A2, Q2 = np.eye(n + 1), np.zeros((n + 1, n + 1))
    A2[:n, :n], Q2[:n, :n], Q2[n, n] = Ad, Q, walk
    z, P, base, out = np.append(xhat0, mean), np.zeros((n + 1, n + 1)), 0, []
    P[:n, :n], P[n, n] = P0, std**2
    xhat = np.array(xhat0, float)
    for k in range(N + 1):
        for one, channels, y in instants(samples, k):
            new, C = max(k - longest - later, 0), model.C[channels]
            z = np.append(moved(Ad, Bd, u, z[:n], base, new), z[n])
            P, base = grown(A2, Q2, P, new - base), new
            place = min(max(due(one, assumed) - z[n] / h, base), k)
            i = min(max(int(np.floor(place)), base), max(k - 1, base))
            part = place - i
            a = moved(Ad, Bd, u, z[:n], base, i)
            b = moved(Ad, Bd, u, a, i, i + 1) if i < k else a
            Fa = matrix_power(Ad, i - base)
            Fb = Ad @ Fa if i < k else Fa
            H = np.column_stack([C @ ((1 - part) * Fa + part * Fb), -(C @ (b - a)) / h])
            S = H @ P @ H.T + np.diag(np.asarray(R)[channels])
            K = P @ H.T @ np.linalg.inv(S)
            z = z + K @ (y - C @ ((1 - part) * a + part * b))
            P = P - K @ S @ K.T
            z[n] = min(max(z[n], 0.0), longest * h)
            xhat = moved(Ad, Bd, u, z[:n], base, k)
        out.append(np.append(xhat, z[n]))
        if k < N:
            xhat = Ad @ xhat + Bd @ u[k]
    return np.array(out)
