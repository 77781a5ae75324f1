"""Threads side by side that begin nothing more once what waits for them has ended: a Ctrl-C waits for no queue. No jax.

Threads of the linear algebra behind NumPy and SciPy: one, as matrices are small here. No jax.

Shared out among threads a matrix exponential of 4 x 4 takes 12 ms on two busy cores instead of 0.03: threads wait for others.
The library reads its setting when it is loaded, so it is to be told before; what the user has set stands.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def pool(threads: int, always_wait: bool = False) -> Iterator[ThreadPoolExecutor]:
    """Yield so many threads. Where the block ends by an error, what has not begun is not done; what has begun is waited for.

    After Ctrl-C that is not waited for, as a compiled call may take minutes: it ends by itself, and nobody reads its results.
    `always_wait`: of what writes files.
    """
    made, wait = ThreadPoolExecutor(threads), True
    try:
        yield made
    except (KeyboardInterrupt, GeneratorExit):  # the latter within a generator whose caller was stopped
        wait = always_wait
        raise
    finally:
        made.shutdown(wait=wait, cancel_futures=True)


LIBRARIES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one() -> None:
    """Have libraries that are not loaded yet work on one thread."""
    for name in LIBRARIES:
        os.environ.setdefault(name, "1")
