"""Observers that act on the newest innovation, from their definitions: held, or with an output predictor.

    held        xhat' = f(xhat, u) + L g,    g_j = y_j(taken) - C_j xhat(taken) of the newest sample of channel j at hand
    predictor   xhat' = f(xhat, u) + L (w - C xhat),    w' = C f(xhat, u)

A sample sets w to y plus what w' has added since it was taken.

Times are ticks, as in `linear`.
"""

from collections.abc import Callable

import numpy as np

from .linear import Array, Model, Sample, by_arrival, powers


def rk4(rate: Callable[[Array], Array], x: Array, h: float) -> Array:
    """Return x one tick of h seconds later."""
    a = rate(x)
    b = rate(x + h / 2 * a)
    c = rate(x + h / 2 * b)
    return x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))


def innovations(samples: list[Sample], C: Array, past: list[Array]) -> Array:
    """Return g [q] of the newest sample of each channel; 0 before the first."""
    g = np.zeros(len(C))
    for channel in range(len(C)):
        own = [s for s in samples if s.channel == channel]
        if own:
            newest = max(own, key=lambda s: s.taken)
            g[channel] = newest.value - C[channel] @ past[newest.taken]
    return g


def run(step: Callable[[int, Array, Array], Array], C: Array, ticks: int, samples: list[Sample], xhat0: Array) -> Array:
    """Return xhat [ticks + 1, n]; `step(k, xhat, g)` moves from tick k to k + 1."""
    inbox, at_hand, past = by_arrival(samples), [], [np.asarray(xhat0, float)]
    for k in range(ticks):
        at_hand += inbox.get(k, [])
        past.append(step(k, past[k], innovations(at_hand, C, past)))
    return np.stack(past)


def over_tick(F: Array, G: Array, h: float) -> tuple[Array, Array]:
    """Return e^{Fh} and its integral times G by their power series, of a tick cut into 64."""
    terms = [M / float(np.prod(range(1, i + 1))) for i, M in enumerate(powers(F * h / 64, 30))]
    part, integral = sum(terms), sum(M / (i + 1) for i, M in enumerate(terms)) * h / 64
    pieces = powers(np.asarray(part), 65)
    return pieces[64], sum(pieces[i] for i in range(64)) @ integral @ G


def linear_run(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array) -> Array:
    """Return xhat [N+1, n] with held innovations."""
    Ad, S = over_tick(model.A, np.hstack([model.B, L]), model.h)
    return run(lambda k, x, g: Ad @ x + S @ np.concatenate([u[k], g]), model.C, len(u) - 1, samples, xhat0)


def predictor_run(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array) -> Array:
    """Return xhat [N+1, n] with an output predictor; the state is (xhat, w, the integral of w')."""
    (n, q), (A, B, C) = L.shape, model[:3]
    none = np.zeros((q, q))
    flow = np.block([[A - L @ C, L, np.zeros((n, q))], [C @ A, none, none], [C @ A, none, none]])
    Fd, Gd = over_tick(flow, np.vstack([B, C @ B, C @ B]), model.h)
    inbox, newest = by_arrival(samples), [-1] * q
    state = np.concatenate([xhat0, C @ xhat0, np.zeros(q)])
    past, xhat = [], []
    for k in range(len(u)):
        past.append(state[n + q :])
        for s in inbox.get(k, []):
            if s.taken > newest[s.channel]:
                newest[s.channel] = s.taken
                state[n + s.channel] = s.value + past[k][s.channel] - past[s.taken][s.channel]
        xhat.append(state[:n])
        state = Fd @ state + Gd @ u[k]
    return np.stack(xhat)
