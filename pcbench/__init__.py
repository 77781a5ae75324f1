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
    "run": "api",
    "trace": "api",
    "design": "api",
    "trade_off": "gains.design",
    "tune": "gains.tune",
    "opened": "dataset.result",
    "Result": "dataset.result",
    "lti": "study.interop",
    "to_scipy": "study.interop",
    "to_control": "study.interop",
    "setup": "machine.process",
    "UserError": "errors",
    "DesignError": "errors",
    "Observer": "protocols",
    "Plant": "protocols",
    "Now": "protocols",
    "Arrival": "protocols",
    "Entry": "observers",
    "plant": "plants",
    "PlantEntry": "plants",
    "Setting": "synthesis.certificate",
    "Design": "synthesis.certificate",
    "Certificate": "synthesis.certificate",
    "certified": "synthesis.certificate",
    "uncertified": "synthesis.certificate",
    "held": "dynamics.linear",
}
__all__ = [*_LAZY, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"pcbench.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'pcbench' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
