"""Computation settings of this process: float64, and a cache of compiled programs between processes."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import jax

from pcbench.errors import UserError, brief_repr, first_sentence
from pcbench.runtime import thread_pools
from pcbench.runtime.cache import folder


def setup() -> None:
    """Set up JAX for pcbench in this process: float64, a compilation cache on disk, linear algebra on one thread.

    The command line calls it. In a notebook, call it before anything else uses JAX. A program with its own JAX configuration
    does not need it: results are the same, but every process compiles again.
    """
    thread_pools.one()
    jax.config.update("jax_enable_x64", True)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(folder("programs")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


@contextmanager
def float64() -> Iterator[None]:
    """Return a context in which jax computes in float64 and compiles, regardless of the host program's settings.

    Raises UserError if jax cannot use the platform in JAX_PLATFORMS.
    """
    try:
        with jax.enable_x64(True), jax.disable_jit(False):
            yield
    except RuntimeError as error:
        if not str(error).startswith("Unable to initialize backend"):
            raise
        raise UserError(
            f"JAX_PLATFORMS: got {brief_repr(os.environ.get('JAX_PLATFORMS', ''))}, which jax cannot use here "
            f"({first_sentence(str(error).partition(': ')[2])}), expected a platform that it has; write cpu, or leave it out."
        ) from None


def name() -> str:
    """Return a name that is unique among processes on all machines."""
    return f"{socket.gethostname()}-{os.getpid()}"
