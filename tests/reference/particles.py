"""The bootstrap particle filter, particle by particle, from tick 0 anew at every tick. Shares no code with pcbench.

The draws are those of `threefry`: kinds 0 (start), 1 (process noise of a tick), 2 + j (resampling after a sample whose first
channel is j), each for its tick. Source: Gordon, Salmond, Smith 1993; Kitagawa 1996.
"""

from functools import cache

import numpy as np
from scipy.special import erfinv

from . import nonlinear, threefry
from .ekf import rk4


@cache
def normals(words, kind, tick, many):
    low, key = np.nextafter(-1.0, 0.0), threefry.fold(words, kind, tick)
    return np.sqrt(2) * erfinv(np.array([threefry.mantissa(key, i) for i in range(many)]) * (1 - low) + low)


def filtered(model, z0, P0, samples, u, many, share, words=(0, 0)):
    """Return the states (mean, P) of all ticks; P0 and Q are diagonal."""
    N = len(z0)

    def kept(x):
        return np.clip(x, model.low, model.high)

    def draw(kind, tick, variance):
        return normals(words, kind, tick, many * N).reshape(many, N) * np.sqrt(np.diag(variance))

    def tick(state, inputs):
        x, w, k = state
        x = np.array([kept(rk4(model.f, z, inputs, model.h) + v) for z, v in zip(x, draw(1, k, model.Q), strict=True)])
        return x, w, k + 1

    def update(state, s):
        (x, w, k), c = state, list(s.channels)
        off = np.array([(np.array(s.values) - model.g(z)[c]) ** 2 / model.R[c] for z in x]).sum(1)
        w = w * np.exp(-0.5 * (off - off.min()))
        w = w / w.sum()
        if 1 / (w @ w) < share * many:
            U, total, i, chosen = threefry.mantissa(threefry.fold(words, 2 + min(c), s.taken), 0), w[0], 0, []
            for j in range(many):
                while total < (j + U) / many and i < many - 1:
                    i += 1
                    total += w[i]
                chosen.append(i)
            x, w = x[chosen], np.full(many, 1 / many)
        return (x, w, k), 0.0

    first = kept(np.array(z0) + draw(0, 0, np.asarray(P0))), np.full(many, 1 / many), 0
    states, _ = nonlinear.run(first, tick, update, samples, u)
    out = []
    for x, w, _ in states:
        m = w @ x
        out.append((m, (x - m).T @ np.diag(w) @ (x - m)))
    return out
