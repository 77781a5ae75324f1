"""pcbench: which observer should I use when my measurements are sampled, late, noisy or lost, and how sure am I?

    import pcbench
    pcbench.setup()                       # all CPUs, float64, compiled programs remembered
    result = pcbench.run("quick")         # .stats, .pairs, .runs as pandas frames

Nothing heavy is imported before it is used.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_LAZY = {
    "run": "bench",
    "trace": "bench",
    "design": "bench",
    "trade_off": "designing",
    "tune": "tuning.effort",
    "opened": "result",
    "Result": "result",
    "lti": "interop",
    "to_scipy": "interop",
    "to_control": "interop",
    "setup": "machine.process",
    "UserError": "errors",
    "Observer": "types",
    "Plant": "types",
    "Now": "types",
    "Arrival": "types",
}
__all__ = [*_LAZY, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"pcbench.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'pcbench' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
