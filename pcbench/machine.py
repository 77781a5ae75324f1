"""The machine of this process: float64, memory, caches, and the record of what made a number."""

import json
import os
import platform
import socket
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

from pcbench.errors import UserError, said, shown
from pcbench.synthesis.cache import folder

COMPILING = (
    "jax_disable_most_optimizations",
    "jax_optimization_level",
    "jax_exec_time_optimization_effort",
    "jax_memory_fitting_effort",
    "jax_default_matmul_precision",
)
ELSEWHERE = ("--xla_dump", "--xla_force_host_platform_device_count")  # flags that change no program
LIBRARIES = ("pcbench", "jax", "jaxlib", "numpy", "scipy", "cvxpy", "clarabel", "pyarrow", "pandas")


def setup() -> None:
    """Give this process to pcbench: float64, compiled programs remembered between processes.

    The command line does this. In a notebook call it first, before anything touches jax; a host program that needs its
    own jax configuration leaves it out: pcbench then computes the same, and compiles anew in every process.
    """
    jax.config.update("jax_enable_x64", True)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(folder() / "programs"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def process() -> str:
    """Return a name for this process among those of all machines."""
    return f"{socket.gethostname()}-{os.getpid()}"


@cache
def versions() -> dict[str, str]:
    """Return what decides the last bits of a number: releases, and what the compiler was told."""
    return {name: version(name) for name in ("pcbench", "jax", "jaxlib")} | {"compiler": compiler()}


def compiler() -> str:
    """Return what the compiler of programs was told beside its defaults, by XLA_FLAGS and jax's settings; or 'defaults'."""
    flags = [word for word in os.environ.get("XLA_FLAGS", "").split() if not word.startswith(ELSEWHERE)]
    settings = {name: getattr(jax.config, name, None) for name in COMPILING}
    told = [f"{name}={value}" for name, value in settings.items() if value and str(value) != "UNKNOWN"]
    return " ".join([*sorted(flags), *told]) or "defaults"


def memory() -> int:
    """Return the bytes of memory that this process may use: the machine's, or what its control group leaves it."""
    import psutil

    total = int(psutil.virtual_memory().total)
    for limit in _limits():
        with suppress(OSError, ValueError):
            total = min(total, int(limit.read_text()))
    return total


def _limits() -> list[Path]:
    """The files that may hold a limit of this process's control group, or of one around it."""
    out = [Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")]
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            _, kinds, path = line.split(":", 2)
            if not kinds or "memory" in kinds.split(","):
                root, name = ("memory", "memory.limit_in_bytes") if kinds else ("", "memory.max")
                parts = Path(path).parts[1:]
                out += [Path("/sys/fs/cgroup", root, *parts[:i], name) for i in range(1, len(parts) + 1)]
    return out


def free_memory() -> int:
    """Return the bytes of memory that are free now, within what this process may use."""
    import psutil

    return min(int(psutil.virtual_memory().available), memory())


UNITS = {"B": 1, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}


def allowed(given: str | int | None) -> float:
    """Return the bytes that results may take: a quarter of the memory unless said otherwise, never more than is free."""
    if given is None:
        return min(memory() / 4, free_memory())
    text = str(given).strip().upper()
    number = text.rstrip("BKMGTI").strip()
    unit = text[len(number) :].strip() or "B"
    try:
        size = float(number) * UNITS[unit if unit.endswith("B") else unit + "B"]
    except (KeyError, ValueError):
        size = -1.0
    if not 0 < size < 1e18:
        raise UserError(f"--memory: got {given!r}, expected an amount such as 500MB or 2GiB; write that.")
    return size


@contextmanager
def float64() -> Iterator[None]:
    """Return a context in which jax computes in float64 and compiles, whatever the host program chose.

    Raises UserError where jax knows no such platform as it was told.
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


def describe() -> dict[str, Any]:
    """Return what a reader needs to know of the machine and the libraries."""
    device = jax.devices()[0]
    return {
        "versions": {name: version(name) for name in LIBRARIES} | {"python": platform.python_version()},
        "compiler": compiler(),
        "device": {"platform": device.platform, "kind": device.device_kind, "count": len(jax.devices())},
        "system": f"{platform.system()} {platform.machine()}",
        "precision": "float64",
        "git": _git(),
    }


def _git() -> dict[str, Any] | None:
    """The state of the checkout pcbench runs from; None where it runs from an installed copy."""
    here = Path(__file__).parent

    def ask(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(here), *words], capture_output=True, text=True, timeout=10)
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        if not ask("ls-files", "__init__.py"):
            return None
        return {"commit": ask("rev-parse", "HEAD"), "changed": bool(ask("status", "--porcelain", "--", str(here)))}
    except (OSError, subprocess.TimeoutExpired):
        return None


def as_json(content: Any) -> str:
    """Return arrays, complex numbers and tuples as readable JSON."""

    def plain(value: Any) -> Any:
        if hasattr(value, "tolist"):
            return plain(value.tolist())
        if isinstance(value, complex):
            return {"real": value.real, "imag": value.imag}
        if isinstance(value, Mapping):
            return {str(k): plain(v) for k, v in value.items()}
        if isinstance(value, tuple | list):
            return [plain(v) for v in value]
        if isinstance(value, float) and value != value:
            return None
        if value in (float("inf"), float("-inf")):
            return str(value)
        return value

    return json.dumps(plain(content), indent=2)
