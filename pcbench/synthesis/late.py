"""The errors' map of a classical observer whose corrections come from the past."""

import numpy as np

from pcbench.synthesis.linear import Matrix


def one_sample(A: Matrix, K: Matrix, C: Matrix, ages: tuple[int, ...]) -> Matrix:
    """Return the map of e(k+1) = A e(k) - sum_j K_j C_j e(k - ages_j), newest first, [n (longest + 1), the same]."""
    n = len(A)
    J = np.eye(n * (max(ages) + 1), k=-n)
    J[:n, :n] += A
    for j, age in enumerate(ages):
        J[:n, n * age : n * (age + 1)] -= np.outer(K[:, j], C[j])
    return J
