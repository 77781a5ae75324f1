"""The errors of a classical observer whose corrections come from the past."""

import numpy as np

from pcbench.dynamics.linear import Matrix

LARGEST = 1500  # rows of a map whose radius is computed


def radius(A: Matrix, K: Matrix, C: Matrix, ages: tuple[int, ...]) -> float:
    """Return the spectral radius of e(k+1) = A e(k) - sum_j K_j C_j e(k - ages_j); NaN where the ages are too long for it."""
    n = len(A)
    if n * (max(ages) + 1) > LARGEST:
        return float("nan")
    J = np.eye(n * (max(ages) + 1), k=-n)
    J[:n, :n] += A
    for j, age in enumerate(ages):
        J[:n, n * age : n * (age + 1)] -= np.outer(K[:, j], C[j])
    return float(np.abs(np.linalg.eigvals(J)).max())
