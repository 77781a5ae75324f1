"""Filters of a nonlinear plant, from tick 0 anew at every tick, with lists and full matrices. Shares no code with pcbench.

z' = f(z, u), u held over a tick of h seconds; a sample is (arrival, taken, channels, values): y_j = g(z)_j + v_j of those.
Whatever has arrived by tick k is used in the order in which it was taken (of one tick: in which it came), each at its own tick,
and the state goes on to k. A state is (z [N], P [N, N]). Sources are those of the filters: Jazwinski 1970 (slopes), Bell,
Cathey 1993 (iterated), Wan, van der Merwe 2000 (points), Arasaratnam, Haykin 2009 (cubature).
"""

from typing import NamedTuple

import numpy as np

from .ekf import rk4, slope


class Sample(NamedTuple):
    """What arrives together of one instant."""

    arrival: int
    taken: int
    channels: tuple[int, ...]
    values: tuple[float, ...]


class Model(NamedTuple):
    """f(z, u), g(z) [q], the tick h [s], Q [N, N] a tick, R [q], and where each entry of z is kept after every step."""

    f: object
    g: object
    h: float
    Q: np.ndarray
    R: np.ndarray
    low: np.ndarray
    high: np.ndarray


def run(first, tick, update, samples, u):
    """Return the states of all ticks, and nu' S^-1 nu with its numbers of what arrives at each, in order of time [N+1, 2]."""
    seen, squares = [], np.zeros((len(u), 2))
    for k in range(len(u)):
        state, at = first, 0
        for s in sorted((s for s in samples if s.arrival <= k), key=lambda s: (s.taken, s.arrival)):
            for j in range(at, s.taken):
                state = tick(state, u[j])
            at = s.taken
            state, square = update(state, s)
            newest = all(o.taken <= s.taken for o in samples if o.arrival <= k)
            if s.arrival == k and newest:
                squares[k] += square, len(s.channels)
        for j in range(at, k):
            state = tick(state, u[j])
        seen.append(state)
    return seen, squares


def output_slope(g, z):
    """dg/dz [q, N] by complex steps."""
    columns = []
    for i in range(len(z)):
        moved = z.astype(complex)
        moved[i] += 1e-30j
        columns.append(g(moved).imag / 1e-30)
    return np.array(columns).T


def by_slopes(model, z0, P0, samples, u, iterations=1):
    """The extended filter, its sensor's slope taken anew `iterations` times."""

    def tick(state, u):
        z, P = state
        F = np.eye(len(z)) + model.h * slope(model.f, z, u)
        return np.clip(rk4(model.f, z, u, model.h), model.low, model.high), F @ P @ F.T + model.Q

    def update(state, s):
        (z, P), some, y = state, list(s.channels), np.array(s.values)
        at, R, squares = z, np.diag(model.R[some]), []
        for _ in range(iterations):
            H = output_slope(model.g, at)[some]
            S = H @ P @ H.T + R
            K = np.linalg.solve(S, H @ P).T
            nu = y - model.g(at)[some] - H @ (z - at)
            at = z + K @ nu
            squares.append(nu @ np.linalg.solve(S, nu))  # the first is of the prediction
        keep = np.eye(len(z)) - K @ H
        return (np.clip(at, model.low, model.high), keep @ P @ keep.T + K @ R @ K.T), squares[0]

    return run((np.array(z0), np.array(P0)), tick, update, samples, u)


def by_points(model, z0, P0, samples, u, alpha=1.0, beta=0.0, kappa=0.0, cubature=False):
    """The unscented filter with its 2 N + 1 weights as printed, or the cubature filter with its 2 N points."""
    N = len(z0)
    lam = alpha**2 * (N + kappa) - N
    each = np.full(2 * N, 0.5 / (N + lam))
    w = np.append(lam / (N + lam), each)
    wc = np.append(lam / (N + lam) + 1 - alpha**2 + beta, each)
    if cubature:
        w, wc = np.full(2 * N, 0.5 / N), np.full(2 * N, 0.5 / N)

    def points(z, P):
        L = np.linalg.cholesky(P) * np.sqrt(N if cubature else N + lam)
        out = [z + s * L[:, i] for s in (1, -1) for i in range(N)]
        return np.array(out if cubature else [z, *out])

    def moments(X):
        m = w @ X
        return m, (X - m).T @ np.diag(wc) @ (X - m)

    def tick(state, u):
        m, P = moments(np.array([rk4(model.f, z, u, model.h) for z in points(*state)]))
        return np.clip(m, model.low, model.high), P + model.Q

    def update(state, s):
        some, y = list(s.channels), np.array(s.values)
        m, J = moments(np.array([np.append(z, model.g(z)[some]) for z in points(*state)]))
        S, across, nu = J[N:, N:] + np.diag(model.R[some]), J[:N, N:], y - m[N:]
        z = m[:N] + across @ np.linalg.solve(S, nu)
        P = J[:N, :N] - across @ np.linalg.solve(S, across.T)
        return (np.clip(z, model.low, model.high), P), nu @ np.linalg.solve(S, nu)

    return run((np.array(z0), np.array(P0)), tick, update, samples, u)
