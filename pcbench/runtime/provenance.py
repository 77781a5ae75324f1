"""The provenance of a result: releases, compiler settings, the device, the checkout."""

import os
import platform
import subprocess
from functools import cache
from importlib.metadata import version
from pathlib import Path

import jax

COMPILING = (
    "jax_disable_most_optimizations",
    "jax_optimization_level",
    "jax_exec_time_optimization_effort",
    "jax_memory_fitting_effort",
    "jax_default_matmul_precision",
)
ELSEWHERE = ("--xla_dump", "--xla_force_host_platform_device_count")  # flags that change no program
LIBRARIES = ("pcbench", "jax", "jaxlib", "numpy", "scipy", "cvxpy", "clarabel", "pyarrow", "pandas")


@cache
def versions() -> dict[str, str]:
    """Return the releases and compiler settings that may change the last bits of a number."""
    return {name: version(name) for name in ("pcbench", "jax", "jaxlib")} | {"compiler": compiler()}


def compiler() -> str:
    """Return how XLA_FLAGS and jax's settings change the compiler's defaults; or 'defaults'."""
    flags = [word for word in os.environ.get("XLA_FLAGS", "").split() if not word.startswith(ELSEWHERE)]
    settings = {name: getattr(jax.config, name, None) for name in COMPILING}
    options = [f"{name}={value}" for name, value in settings.items() if value and str(value) != "UNKNOWN"]
    return " ".join([*sorted(flags), *options]) or "defaults"


def describe() -> dict[str, object]:
    """Return the description of machine and libraries for a report."""
    device = jax.devices()[0]
    return {
        "versions": {name: version(name) for name in LIBRARIES} | {"python": platform.python_version()},
        "compiler": compiler(),
        "device": {"platform": device.platform, "kind": device.device_kind, "count": len(jax.devices())},
        "system": f"{platform.system()} {platform.machine()}",
        "precision": "float64",
        "git": _git(),
    }


def _git() -> dict[str, str | bool] | None:
    """Return the state of the checkout that pcbench runs from; None for an installed copy."""
    folder = Path(__file__).parent.parent

    def ask(*words: str) -> str:
        process = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=10)
        return process.stdout.strip() if process.returncode == 0 else ""

    try:
        if not ask("ls-files", "__init__.py"):
            return None
        return {"commit": ask("rev-parse", "HEAD"), "changed": bool(ask("status", "--porcelain", "--", str(folder)))}
    except (OSError, subprocess.TimeoutExpired):
        return None
