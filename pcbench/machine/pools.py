"""Threads side by side that begin nothing more once what waits for them has ended: a Ctrl-C waits for no queue. No jax."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def pool(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Yield so many threads. Where the block ends by an error, what has not begun is not done; what has begun is waited for."""
    made = ThreadPoolExecutor(threads)
    try:
        yield made
    finally:
        made.shutdown(wait=True, cancel_futures=True)
