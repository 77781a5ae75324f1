"""How this process computes: float64, and compiled programs remembered between processes."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import jax

from pcbench.errors import UserError, brief_repr, first_sentence
from pcbench.runtime import thread_pools
from pcbench.runtime.cache import folder

EXTRA = "--xla_backend_extra_options"
FUSION = (
    "xla_cpu_use_multi_output_fusion"  # results computed from the same arrays in one loop, as jax 0.11 does by itself
)


def setup() -> None:
    """Set up JAX for pcbench in this process: float64, a compilation cache on disk, linear algebra on one thread.

    The command line does this. In a notebook, call it before anything else uses JAX. A program with a JAX configuration of
    its own does not need it: pcbench then computes the same, to jax 0.10 more slowly (see `compiler_flags`), and compiles again
    in every process.
    """
    thread_pools.one()
    if flags := compiler_flags(os.environ.get("XLA_FLAGS", "")):
        os.environ["XLA_FLAGS"] = flags
    jax.config.update("jax_enable_x64", True)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(folder("programs")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def compiler_flags(flags: str) -> str:
    """Return XLA_FLAGS with what makes programs fast on a processor; what the flags already set stays.

    To jax 0.10, results that are computed from the same arrays have a loop each; in one loop programs take a half to a third of
    the time. From jax 0.11 on XLA does that by itself.
    """
    newer = jax.__version_info__[:2] > (0, 10)
    return flags if newer or EXTRA in flags else f"{flags} {EXTRA}={FUSION}".strip()


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
