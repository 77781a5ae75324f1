"""Moving horizon estimation with dense matrices: one large least-squares problem at every sample. Shares no code with pcbench.

At a sample z_0 .. z_M of the newest M samples and of the one before are found by Gauss-Newton: slopes along the last path, then
the least squares of |z_0 - m|^2 by P, of the motion by what noise it gathers, of the samples by R; with bounds by scipy's
active sets. m, P: what was found of that sample when it was the newest, and an extended filter's covariance there. Source: Rao,
Rawlings, Mayne 2003. P and the gathered noise must not be singular.
"""

from itertools import pairwise

import numpy as np
from scipy.optimize import lsq_linear

from . import nonlinear
from .ekf import rk4, slope


def whitened(S, M):
    return np.linalg.solve(np.linalg.cholesky(S), M)


def estimated(model, z0, P0, samples, u, window, iterations, low=None, high=None):
    """Return (z, P) of every tick as `nonlinear.run` does; samples are those of it."""
    N, start = len(z0), np.array(z0, float)
    bounded = low is not None

    def moved(z, a, b):
        F, Q = np.eye(N), np.zeros((N, N))
        for k in range(a, b):
            A = np.eye(N) + model.h * slope(model.f, z, u[k])
            z, F, Q = rk4(model.f, z, u[k], model.h), A @ F, A @ Q @ A.T + model.Q
        return z, F, Q

    def tick(state, inputs):
        z, P, k, past = state
        A = np.eye(N) + model.h * slope(model.f, z, inputs)
        return np.clip(rk4(model.f, z, inputs, model.h), model.low, model.high), A @ P @ A.T + model.Q, k + 1, past

    def solve(prior, some, path):
        (m, P, _), times = prior, [prior[2], *(s.taken for s in some)]
        own = np.cumsum([0, *(b > a for a, b in pairwise(times))])  # of one instant there is one state
        wide = N * (own[-1] + 1)

        def block(height, **at):
            out = np.zeros((height, wide))
            for i, part in at.items():
                out[:, N * own[int(i[1:])] : N * (own[int(i[1:])] + 1)] += part
            return out

        for _ in range(iterations):
            rows, rhs = [block(N, z0=whitened(P, np.eye(N)))], [whitened(P, m)]
            for i, s in enumerate(some):
                if times[i + 1] > times[i]:
                    f, F, Q = moved(path[i], times[i], times[i + 1])
                    rows.append(block(N, **{f"z{i}": whitened(Q, -F), f"z{i + 1}": whitened(Q, np.eye(N))}))
                    rhs.append(whitened(Q, f - F @ path[i]))
                c, z = list(s.channels), path[i + 1]
                H, std = nonlinear.output_slope(model.g, z)[c], np.sqrt(model.R[c])
                rows.append(block(len(c), **{f"z{i + 1}": H / std[:, None]}))
                rhs.append((np.array(s.values) - model.g(z)[c] + H @ z) / std)
            A, b = np.vstack(rows), np.concatenate(rhs)
            if bounded:
                found = lsq_linear(
                    A, b, (np.tile(low, own[-1] + 1), np.tile(high, own[-1] + 1)), method="bvls", tol=1e-15
                ).x
            else:
                found = np.linalg.lstsq(A, b, rcond=None)[0]
            path = found.reshape(-1, N)[own]
        return path

    def update(state, s):
        z, P, k, past = state
        c = list(s.channels)
        H, R = nonlinear.output_slope(model.g, z)[c], np.diag(model.R[c])
        S = H @ P @ H.T + R
        K, nu = np.linalg.solve(S, H @ P).T, np.array(s.values) - model.g(z)[c]
        keep = np.eye(N) - K @ H
        corrected, P = np.clip(z + K @ nu, model.low, model.high), keep @ P @ keep.T + K @ R @ K.T
        kept = past["known"][-window:]  # (sample, m, P) of those before, the prior among them
        path = np.vstack([past["path"][-window:], corrected])
        first = kept[0]
        path = solve((first[1], first[2], first[0].taken if first[0] else 0), [*(o[0] for o in kept[1:]), s], path)
        known = [*past["known"], (s, path[-1], P)]
        return (path[-1], P, k, {"known": known, "path": path}), nu @ np.linalg.solve(S, nu)

    first = start, np.array(P0, float), 0, {"known": [(None, start, np.array(P0, float))], "path": start[None]}
    states, squares = nonlinear.run(first, tick, update, samples, u)
    return [(z, P) for z, P, *_ in states], squares
