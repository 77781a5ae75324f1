"""How this process computes: float64, and compiled programs remembered between processes."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from platform import machine

import jax

from pcbench.errors import UserError, said, shown
from pcbench.machine import threads
from pcbench.machine.cache import folder

NO_FMA = "--xla_cpu_max_isa"  # AVX is the last instruction set of x86 without it


def setup() -> None:
    """Give this process to pcbench: float64, compiled programs remembered between processes, linear algebra on one thread.

    The command line does this. In a notebook call it first, before anything touches jax; a host program that needs its
    own jax configuration leaves it out: pcbench then computes the same, and compiles anew in every process. From jax 0.11 on it
    keeps x86 processors from joining a product and a sum into one operation (FMA): whether that is done depends on what else is
    in a program, so that the last bit of a run would depend on which other observers are simulated with it.
    """
    threads.one()
    if (
        machine() in ("x86_64", "AMD64")
        and jax.__version_info__[:2] > (0, 10)
        and NO_FMA not in os.environ.get("XLA_FLAGS", "")
    ):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {NO_FMA}=AVX".strip()
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
            f"JAX_PLATFORMS: got {shown(os.environ.get('JAX_PLATFORMS', ''))}, which jax cannot use here "
            f"({said(str(error).partition(': ')[2])}), expected a platform that it has; write cpu, or leave it out."
        ) from None


def name() -> str:
    """Return a name that tells this process from all others, on any machine."""
    return f"{socket.gethostname()}-{os.getpid()}"
