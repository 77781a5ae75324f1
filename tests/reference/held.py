"""The observer that holds its innovations, from its definition: linear, or nonlinear by one Runge-Kutta step a tick.

    xhat' = f(xhat, u) + L g,    g_j = y_j(taken) - C_j xhat(taken) of the newest sample of channel j at hand

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


def linear_run(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array) -> Array:
    """Return xhat [N+1, n]: e^{Ah} and its integral by their power series, of a tick cut into 64."""
    small = model.A * model.h / 64
    terms = [M / float(np.prod(range(1, i + 1))) for i, M in enumerate(powers(small, 30))]
    part, integral = sum(terms), sum(M / (i + 1) for i, M in enumerate(terms)) * model.h / 64
    pieces = powers(np.asarray(part), 65)
    Ad, S = pieces[64], sum(pieces[i] for i in range(64)) @ integral
    return run(lambda k, x, g: Ad @ x + S @ (model.B @ u[k] + L @ g), model.C, len(u) - 1, samples, xhat0)
