"""Standard observers of the field, written out the long way: loops over ticks and samples, as in `reference.linear`.

Order of a tick, times and samples are those of `reference.linear`.
"""

import numpy as np

from reference.linear import Array, Model, Sample, pccebo


def eso_gain(omega: float, T: float) -> Array:
    """Return the gain [3] of the discrete extended state observer of a double integrator (Miklosovic, Radke, Gao 2006)."""
    beta = np.exp(-omega * T)
    return np.array([1 - beta**3, 3 * (1 - beta) ** 2 * (1 + beta) / (2 * T), (1 - beta) ** 3 / T**2])


def with_disturbance(model: Model) -> Model:
    """Return the model with a constant disturbance of its one input as the last state."""
    n = len(model.A)
    A = np.zeros((n + 1, n + 1))
    A[:n, :n], A[:n, n:] = model.A, model.B
    return Model(A, np.vstack([model.B, [[0.0]]]), np.hstack([model.C, [[0.0]]]), model.h)


def eso(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array) -> Array:
    """Return xhat [N+1, n] of the extended state observer with L [n+1, 1], d(0) = 0."""
    z = pccebo(with_disturbance(model), u, samples, np.append(xhat0, 0.0), L)
    return z[:, : len(model.A)]
