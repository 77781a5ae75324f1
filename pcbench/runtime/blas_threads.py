"""Threads of the linear algebra behind NumPy and SciPy: one, as matrices are small here. No jax.

Shared out among threads a matrix exponential of 4 x 4 takes 12 ms on two busy cores instead of 0.03: threads wait for others.
The library reads its setting when it is loaded, so it is to be told before; what the user has set stands.
"""

import os

LIBRARIES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one() -> None:
    """Have libraries that are not loaded yet work on one thread."""
    for name in LIBRARIES:
        os.environ.setdefault(name, "1")
