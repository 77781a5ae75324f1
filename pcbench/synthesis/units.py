"""Units in which gains are sought: the solution of an LMI depends on the units of states and outputs."""

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.synthesis.certificate import Setting


def prior_size(setting: Setting) -> Matrix:
    """Return the size of x(0) [n], 1 where it is known."""
    return positive(np.sqrt(np.diag(setting.P0)))


def of_rows(C: Matrix, size: Matrix) -> Matrix:
    """Return the size of every row of C x [q] of states of a `size` [n]; 1 where it is 0."""
    return positive(np.linalg.norm(C * size, axis=1))


def positive(size: Matrix) -> Matrix:
    """Return sizes, 1 in place of 0."""
    return np.where(size > 0, size, 1.0)
