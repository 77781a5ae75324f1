"""Expected squares in a closed loop by superposition: every quantity is a matrix of coefficients of independent unit normals.

Column 0 is the value without noise, the others are the start (n, if it is random), the process noise of each tick (n), and the
noise of each measurement (q). The Kalman filter starts from tick 0 at every arrival (`loop.filtered`). No covariance is
propagated: E z'Q z = tr(Q Z Z'). Times are ticks; the loop's delays are constant, and nothing is lost.
"""

from typing import NamedTuple

import numpy as np

from . import loop

Array = np.ndarray


class Coefficients(NamedTuple):
    """Of the states, the estimates and the inputs at ticks 0 .. N - 1: [N, numbers, 1 + M]."""

    x: Array
    xhat: Array
    u: Array


def coefficients(
    p: loop.Plant, sensor: loop.Network, law: object, N: int, every: int = 1, late: int = 0
) -> Coefficients:
    """Return a closed loop's coefficients; commands are decided `every` so many ticks and act `late` ticks later."""
    (n, m), q = p.Gamma.shape, len(p.C)
    samples = -(-N // sensor.every)
    M = 1 + n + N * n + samples * q

    def columns(first: int, G: Array) -> Array:
        out = np.zeros((len(G), M))
        out[:, first : first + G.shape[1]] = G
        return out

    def constant(a: Array) -> Array:
        return columns(0, a[:, None])

    filtered = p._replace(xhat0=constant(p.xhat0))
    x, kept = constant(p.x0) + columns(1, np.linalg.cholesky(p.P0) if p.P0.any() else np.zeros((n, n))), None
    measured: dict[int, Array] = {}
    xhat, sent, held, xs, hats = filtered.xhat0, [], [], [], []
    for k in range(N):
        if k % sensor.every == 0:
            noise = columns(1 + n + N * n + k // sensor.every * q, np.diag(p.noise))
            measured[k] = p.C @ x + noise
        if k >= sensor.delay and (k - sensor.delay) % sensor.every == 0:
            there = {t: y for t, y in measured.items() if t + sensor.delay <= k}
            xhat, _ = loop.filtered(filtered, held, there, k)
        if k % every == 0:
            command, kept = law(p, k, xhat, sent, kept)
        sent.append(command)
        held.append(sent[k - late] if k >= late else np.zeros((m, M)))
        xs.append(x)
        hats.append(xhat)
        x = p.Phi @ x + p.Gamma @ held[k] + columns(1 + n + k * n, np.diag(p.process))
        xhat = p.Phi @ xhat + p.Gamma @ held[k]
    return Coefficients(np.stack(xs), np.stack(hats), np.stack(held))


def square(Q: Array, z: Array) -> Array:
    """Return E z'Q z [N] of coefficients [N, numbers, 1 + M]."""
    return np.einsum("kim,ij,kjm->k", z, Q, z)


def constants(a: Array, M: int) -> Array:
    """Return known numbers [T, r] as coefficients [T, r, M]."""
    out = np.zeros((*a.shape, M))
    out[..., 0] = a
    return out
