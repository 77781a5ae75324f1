"""Thread pools that start no new work after an interrupt, and single-threaded linear algebra. No jax.

Linear algebra of NumPy and SciPy uses one thread, as matrices are small here. With several threads on two busy cores, a matrix
exponential of 4 x 4 takes 12 ms instead of 0.03. The libraries read the setting when they are loaded, so it must be set before.
A setting by the user is kept.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def pool(threads: int, always_wait: bool = False) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of `threads` threads. After an error, queued work is dropped and running work is awaited.

    After Ctrl-C running work is not awaited either, as a compiled call may take minutes and its result is unused. Set
    `always_wait` for work that writes files.
    """
    executor, wait = ThreadPoolExecutor(threads), True
    try:
        yield executor
    except (KeyboardInterrupt, GeneratorExit):  # GeneratorExit: inside a generator whose caller was stopped
        wait = always_wait
        raise
    finally:
        executor.shutdown(wait=wait, cancel_futures=True)


LIBRARIES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one() -> None:
    """Set libraries that are not yet loaded to one thread."""
    for name in LIBRARIES:
        os.environ.setdefault(name, "1")
