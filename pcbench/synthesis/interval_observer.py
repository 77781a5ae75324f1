"""An interval observer of a sampled linear plant: bounds of the state that hold for all noise within given bounds.

The error obeys e(k+1) = M e(k) + b w - K v with |w| <= wmax, |v| <= vmax, and M = V diag(l) V^-1 has real distinct eigenvalues:

    r(k+1) = |l| r(k) + |V^-1 b| wmax + |V^-1 K| vmax,     |V^-1 e| <= r,     x in xhat +- |V| r

The width 2 |V| r is the same in every run. In every run that respects the bounds, the interval contains the state (coverage 1).
Source: ours, after Mazenc, Dinh, Automatica 50(10), 2014, which was not obtained.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix


class IntervalObserver(NamedTuple):
    """x(k+1) = A x + b w, y = C x + v, with the predictor's gain K and the bounds of w and v; n states."""

    A: Matrix  # [n, n]
    b: Matrix  # [n]
    C: Matrix  # [n]
    K: Matrix  # [n]
    wmax: float
    vmax: float


class Noise(NamedTuple):
    """The largest |w| and |v| of a simulation."""

    w: float
    v: float


def double_integrator(period: float, poles: tuple[float, float], wmax: float, vmax: float) -> IntervalObserver:
    """Return the observer of a double integrator with a measured position and these real distinct eigenvalues of M."""
    total, product = sum(poles), poles[0] * poles[1]
    A, b = np.array([[1.0, period], [0.0, 1.0]]), np.array([period**2 / 2, period])
    K = np.array([2 - total, (1 - total + product) / period])
    return IntervalObserver(A=A, b=b, C=np.array([1.0, 0.0]), K=K, wmax=wmax, vmax=vmax)


def modes(observer: IntervalObserver) -> tuple[Matrix, Matrix, Matrix]:
    """Return the eigenvalues l [n], V [n, n], and what one step adds to the radius r [n]."""
    l, V = np.linalg.eig(observer.A - np.outer(observer.K, observer.C))
    back = np.linalg.inv(V)
    return l, V, np.abs(back @ observer.b) * observer.wmax + np.abs(back @ observer.K) * observer.vmax


def final_width(observer: IntervalObserver) -> Matrix:
    """Return the width of the interval of each state [n] after many steps."""
    l, V, added = modes(observer)
    return np.asarray(2 * np.abs(V) @ (added / (1 - np.abs(l))))


def coverage(
    observer: IntervalObserver, start: float, runs: int, steps: int, seed: int, noise: Noise | None = None
) -> float:
    """Return the share of states within their interval, over all steps, states and runs from `seed`.

    x(0) is uniform in xhat(0) +- `start`; w and v are at a random end of their range. `noise`: its true bounds, if they differ
    from those that the observer assumes.
    """
    l, V, added = modes(observer)
    true = noise or Noise(observer.wmax, observer.vmax)
    generator, n = np.random.default_rng(seed), len(observer.A)
    e = generator.uniform(-start, start, (runs, n))
    r = np.abs(np.linalg.inv(V)) @ np.full(n, start)
    M, inside = observer.A - np.outer(observer.K, observer.C), 0
    for _ in range(steps):
        inside += int((np.abs(e) <= np.abs(V) @ r * (1 + 1e-12)).sum())
        w, v = (bound * generator.choice([-1.0, 1.0], runs) for bound in true)
        e = e @ M.T + np.outer(w, observer.b) - np.outer(v, observer.K)
        r = np.abs(l) * r + added
    return inside / (runs * steps * n)
