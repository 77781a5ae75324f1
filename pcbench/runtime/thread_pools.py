"""Threads side by side that begin nothing more once what waits for them has ended: a Ctrl-C waits for no queue. No jax."""

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
