"""How this process computes: float64, and compiled programs remembered between processes."""

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

    The command line does this. In a notebook, call it before anything else uses JAX. A program with a JAX configuration of
    its own does not need it: pcbench then computes the same, and compiles again in every process.
    """
    thread_pools.one()
    jax.config.update("jax_enable_x64", True)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(folder("programs")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


@contextmanager
def float64() -> Iterator[None]:
    """Return a context in which jax computes in float64 and compiles, whatever the host program chose.

    Raises UserError where jax cannot use the platform that JAX_PLATFORMS names.
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
    """Return a name that tells this process from all others, on any machine."""
    return f"{socket.gethostname()}-{os.getpid()}"
