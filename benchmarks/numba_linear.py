"""Simulations of a linear plant as scalar loops in numba: process noise, a schedule for each run, a closed loop.

For the comparison of `numba_cases.py`. A loop simulates one run: plant, observers, and for each error the sum of |e|, the sum
of e^2 and the peak, out[3, errors]. It takes the numbers of the case as a NamedTuple, then the run's draws, `noise` (standard
normal) and `uniform`. So the same loop runs on pcbench's draws, to be checked, and on numba's own, to be timed.

Equations and order of events are pcbench's (see the plants, observers and controllers of these names). The loops leave out
what a case does not have: inputs that are zero, drifts, several rates, samples out of sequence, divergence. Sampling, delay
and arrays are those of the case; matrices of 2 x 2 are written out. Everything that is equal in all runs (powers of Phi,
responses to a common input, set points) is computed beforehand. Measured samples are numbered from 0; `noise` has those of
channel 0, then of channel 1, then the process noise by tick.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
njit = numba.njit  # without fastmath: the same arithmetic as pcbench

ZERO = (0.0, 0.0, 0.0)


@njit
def _times(M, x):
    return M[0, 0] * x[0] + M[0, 1] * x[1], M[1, 0] * x[0] + M[1, 1] * x[1]


@njit
def _plus(x, y):
    return x[0] + y[0], x[1] + y[1]


@njit
def _minus(x, y):
    return x[0] - y[0], x[1] - y[1]


@njit
def _score(sums, e):
    size = abs(e)
    return sums[0] + size, sums[1] + e * e, max(sums[2], size)


class Linear(NamedTuple):
    """Two states, one input, one output; N ticks. Tables by age in ticks have every age that occurs."""

    ticks: int
    period: int  # [ticks]
    delay: int  # [ticks]
    jitter: int  # [ticks]
    loss: float
    noise_std: float
    process_std: Array  # [2]
    x0: Array  # [2]
    xhat0: Array  # [2]
    Phi: Array  # [2, 2]
    Gamma: Array  # [2]
    c: Array  # [2] output
    moved: Array  # [N, 2] Gamma u
    g: Array  # [N + 1, 2] response to the input from zero state
    powers: Array  # [ages, 2, 2] Phi^age
    Q: Array  # [ages, 2, 2] process noise over `age` ticks, as kf assumes it
    P0: Array  # [2, 2]
    R: float
    L: Array  # [2] of pccebo
    K: Array  # [2] of the regulator


@njit
def _kf(E, Q, c, R, free, P, g, y):
    """Predict xhat - g and P = (P00, P01, P11) by E and Q, and update them with the sample y."""
    a, b = E[0, 0] * P[0] + E[0, 1] * P[1], E[0, 0] * P[1] + E[0, 1] * P[2]
    d, f = E[1, 0] * P[0] + E[1, 1] * P[1], E[1, 0] * P[1] + E[1, 1] * P[2]
    p, q, r = (
        a * E[0, 0] + b * E[0, 1] + Q[0, 0],
        a * E[1, 0] + b * E[1, 1] + Q[0, 1],
        d * E[1, 0] + f * E[1, 1] + Q[1, 1],
    )
    h0, h1 = p * c[0] + q * c[1], q * c[0] + r * c[1]
    s = c[0] * h0 + c[1] * h1 + R
    k0, k1 = h0 / s, h1 / s
    free = _times(E, free)
    nu = y - c[0] * (g[0] + free[0]) - c[1] * (g[1] + free[1])
    i00, i01, i10, i11 = 1.0 - k0 * c[0], -k0 * c[1], -k1 * c[0], 1.0 - k1 * c[1]
    a, b, d, f = i00 * p + i01 * q, i00 * q + i01 * r, i10 * p + i11 * q, i10 * q + i11 * r
    P = a * i00 + b * i01 + k0 * R * k0, a * i10 + b * i11 + k0 * R * k1, d * i10 + f * i11 + k1 * R * k1
    return (free[0] + k0 * nu, free[1] + k1 * nu), P


@njit
def _measure(case, x, v):
    return case.c[0] * x[0] + case.c[1] * x[1] + case.noise_std * v


@njit
def process_noise(case, noise, uniform, out):
    """Open loop with process noise, observers pccebo and kf; the delay is a multiple of the sampling period."""
    Phi, N = case.Phi, case.ticks
    samples = -(-N // case.period)
    x, p, q = (case.x0[0], case.x0[1]), (case.xhat0[0], case.xhat0[1]), (case.xhat0[0], case.xhat0[1])
    free_p, free_q, P = p, q, (case.P0[0, 0], case.P0[0, 1], case.P0[1, 1])
    s0, s1, s2, s3, w0, w1 = ZERO, ZERO, ZERO, ZERO, case.process_std[0], case.process_std[1]
    y = np.empty(samples)
    for i in range(samples):
        first = i * case.period
        y[i] = _measure(case, x, noise[i])
        arrived = i - case.delay // case.period
        if arrived >= 0:
            taken, age = arrived * case.period, case.period if arrived else 0
            g, ahead = (case.g[taken, 0], case.g[taken, 1]), case.powers[case.delay]
            free_p = _times(case.powers[age], free_p)
            nu = y[arrived] - case.c[0] * (g[0] + free_p[0]) - case.c[1] * (g[1] + free_p[1])
            free_p = free_p[0] + case.L[0] * nu, free_p[1] + case.L[1] * nu
            free_q, P = _kf(case.powers[age], case.Q[age], case.c, case.R, free_q, P, g, y[arrived])
            now = case.g[first, 0], case.g[first, 1]
            p, q = _plus(now, _times(ahead, free_p)), _plus(now, _times(ahead, free_q))
        for k in range(first, min(first + case.period, N)):
            e, f = _minus(x, p), _minus(x, q)
            s0, s1, s2, s3 = _score(s0, e[0]), _score(s1, e[1]), _score(s2, f[0]), _score(s3, f[1])
            u, w = (case.moved[k, 0], case.moved[k, 1]), samples + 2 * k
            x = _plus(_plus(_times(Phi, x), u), (w0 * noise[w], w1 * noise[w + 1]))
            p, q = _plus(_times(Phi, p), u), _plus(_times(Phi, q), u)
    for j in range(3):
        out[j, 0], out[j, 1], out[j, 2], out[j, 3] = s0[j], s1[j], s2[j], s3[j]


@njit
def random_schedule(case, noise, uniform, out):
    """The same with sampling jitter and loss of each run's own, observer kf."""
    Phi, N, samples = case.Phi, case.ticks, len(uniform) // 2
    taken = np.empty(samples + 1, np.int64)
    for i in range(samples):
        shift = int(uniform[i] * (2 * case.jitter + 1)) - case.jitter if i else 0
        taken[i] = i * case.period + shift
    taken[samples] = N  # no further sample
    x, q = (case.x0[0], case.x0[1]), (case.xhat0[0], case.xhat0[1])
    free, P, last = q, (case.P0[0, 0], case.P0[0, 1], case.P0[1, 1]), 0
    s0, s1, w0, w1 = ZERO, ZERO, case.process_std[0], case.process_std[1]
    y = np.empty(samples)
    k = sampled = arrived = 0
    while k < N:
        if taken[sampled] == k:
            y[sampled] = _measure(case, x, noise[sampled])
            sampled += 1
        while arrived < sampled and (uniform[samples + arrived] < case.loss or taken[arrived] + case.delay == k):
            if uniform[samples + arrived] >= case.loss:
                t = taken[arrived]
                g = case.g[t, 0], case.g[t, 1]
                free, P = _kf(case.powers[t - last], case.Q[t - last], case.c, case.R, free, P, g, y[arrived])
                q, last = _plus((case.g[k, 0], case.g[k, 1]), _times(case.powers[k - t], free)), t
            arrived += 1
        stop = min(taken[sampled], N)
        if arrived < sampled:
            stop = min(stop, taken[arrived] + case.delay)
        for t in range(k, stop):
            e = _minus(x, q)
            s0, s1 = _score(s0, e[0]), _score(s1, e[1])
            u, w = (case.moved[t, 0], case.moved[t, 1]), samples + 2 * t
            x = _plus(_plus(_times(Phi, x), u), (w0 * noise[w], w1 * noise[w + 1]))
            q = _plus(_times(Phi, q), u)
        k = stop
    for j in range(3):
        out[j, 0], out[j, 1] = s0[j], s1[j]


@njit
def closed_loop(case, noise, uniform, out):
    """The same plant under u = -K xhat at every tick, observer kf; now g depends on the run."""
    Phi, N = case.Phi, case.ticks
    samples = -(-N // case.period)
    x, q, g = (case.x0[0], case.x0[1]), (case.xhat0[0], case.xhat0[1]), (0.0, 0.0)
    free, P = q, (case.P0[0, 0], case.P0[0, 1], case.P0[1, 1])
    s0, s1, w0, w1 = ZERO, ZERO, case.process_std[0], case.process_std[1]
    b0, b1, k0, k1 = case.Gamma[0], case.Gamma[1], case.K[0], case.K[1]
    y, snapshots = np.empty(samples), np.empty((samples, 2))
    for i in range(samples):
        first = i * case.period
        y[i] = _measure(case, x, noise[i])
        snapshots[i, 0], snapshots[i, 1] = g[0], g[1]
        arrived = i - case.delay // case.period
        if arrived >= 0:
            age, then = case.period if arrived else 0, (snapshots[arrived, 0], snapshots[arrived, 1])
            free, P = _kf(case.powers[age], case.Q[age], case.c, case.R, free, P, then, y[arrived])
            q = _plus(g, _times(case.powers[case.delay], free))
        for k in range(first, min(first + case.period, N)):
            e = _minus(x, q)
            s0, s1 = _score(s0, e[0]), _score(s1, e[1])
            u, w = -(k0 * q[0] + k1 * q[1]), samples + 2 * k
            move = b0 * u, b1 * u
            x = _plus(_plus(_times(Phi, x), move), (w0 * noise[w], w1 * noise[w + 1]))
            q, g = _plus(_times(Phi, q), move), _plus(_times(Phi, g), move)
    for j in range(3):
        out[j, 0], out[j, 1] = s0[j], s1[j]
