"""Units of 1000^k (k whole) in which gains are sought: the solution of an LMI depends on the units of the states."""

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.synthesis.certificate import DesignContext


def near(size: Matrix) -> Matrix:
    """Return the units nearest to sizes [n], 1 for a size of 0. Units of sizes a thousand times larger are so much larger."""
    return 1000.0 ** np.round(np.log10(np.where(size > 0, size, 1.0)) / 3)


def prior_size(setting: DesignContext) -> Matrix:
    """Return the size of x(0) [n], 1 where it is known."""
    size = np.sqrt(np.diag(setting.P0))
    return np.where(size > 0, size, 1.0)
