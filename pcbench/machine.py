"""The machine of this process: float64, devices, caches, and the record of what made a number."""

import json
import os
import platform
import subprocess
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

from pcbench.synthesis.cache import folder

LIBRARIES = ("pcbench", "jax", "jaxlib", "numpy", "scipy", "cvxpy", "clarabel", "pyarrow", "pandas")


def setup() -> None:
    """Give this process to pcbench: float64, every CPU a device, compiled programs remembered between processes.

    The command line does this. In a notebook call it first, before anything touches jax; a host program that needs its
    own jax configuration leaves it out, and pcbench then uses the devices it finds.
    """
    jax.config.update("jax_enable_x64", True)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        try:
            jax.config.update("jax_num_cpu_devices", cores)
        except RuntimeError:
            warnings.warn("jax is already running: pcbench.setup() cannot change its CPU devices.", stacklevel=2)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(folder() / "programs"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def float64() -> Any:
    """Return a context in which jax computes in float64, whatever the host program chose."""
    return jax.enable_x64(True)


def describe() -> dict[str, Any]:
    """Return what a reader needs to know of the machine and the libraries."""
    device = jax.devices()[0]
    return {
        "versions": {name: version(name) for name in LIBRARIES} | {"python": platform.python_version()},
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
