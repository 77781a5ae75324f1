"""pcbench: compare state observers for measurements that are sampled, delayed, noisy or lost, with statistical significance.

    import pcbench
    pcbench.setup()                       # all CPUs, float64, a cache of compiled programs
    result = pcbench.run("quick")         # .stats, .pairs, .runs as pandas frames

Large libraries are imported when they are used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names, for type checkers and editors
    from pcbench.api import design as design
    from pcbench.api import exact_moments as exact_moments
    from pcbench.api import operation_counts as operation_counts
    from pcbench.api import run as run
    from pcbench.api import simulate as simulate
    from pcbench.api import tune as tune
    from pcbench.controllers import ControllerSpec as ControllerSpec
    from pcbench.controllers.parts.common import ControllerContext as ControllerContext
    from pcbench.dataset.moments_frames import Exact as Exact
    from pcbench.dataset.result import Result as Result
    from pcbench.dataset.result import open_result as open_result
    from pcbench.dynamics.linear import discretize_zoh as discretize_zoh
    from pcbench.errors import DesignError as DesignError
    from pcbench.errors import UserError as UserError
    from pcbench.gains.design import trade_off as trade_off
    from pcbench.limits.find_limit import find_limit as find_limit
    from pcbench.observers import ObserverSpec as ObserverSpec
    from pcbench.observers.parts.options import tunable as tunable
    from pcbench.plants import PlantSpec as PlantSpec
    from pcbench.plants import make_plant as make_plant
    from pcbench.playback.replay import replay as replay
    from pcbench.protocols import Arrival as Arrival
    from pcbench.protocols import Controller as Controller
    from pcbench.protocols import InnovationStats as InnovationStats
    from pcbench.protocols import Now as Now
    from pcbench.protocols import Observer as Observer
    from pcbench.protocols import Plant as Plant
    from pcbench.protocols import vmap_as_unit as vmap_as_unit
    from pcbench.recordings.survey import info as info
    from pcbench.runtime.config import setup as setup
    from pcbench.study.interop import lti as lti
    from pcbench.study.interop import to_control as to_control
    from pcbench.study.interop import to_scipy as to_scipy
    from pcbench.synthesis.certificate import Certificate as Certificate
    from pcbench.synthesis.certificate import Design as Design
    from pcbench.synthesis.certificate import DesignContext as DesignContext
    from pcbench.synthesis.certificate import no_certificate as no_certificate
    from pcbench.synthesis.certificate import require_certified as require_certified

__version__ = "0.1.0"

_LAZY = {
    "run": "api",
    "exact_moments": "api",
    "operation_counts": "api",
    "simulate": "api",
    "design": "api",
    "trade_off": "gains.design",
    "tune": "api",
    "find_limit": "limits.find_limit",
    "info": "recordings.survey",
    "replay": "playback.replay",
    "open_result": "dataset.result",
    "Result": "dataset.result",
    "Exact": "dataset.moments_frames",
    "lti": "study.interop",
    "to_scipy": "study.interop",
    "to_control": "study.interop",
    "setup": "runtime.config",
    "UserError": "errors",
    "DesignError": "errors",
    "Observer": "protocols",
    "Plant": "protocols",
    "Now": "protocols",
    "Arrival": "protocols",
    "InnovationStats": "protocols",
    "ObserverSpec": "observers",
    "vmap_as_unit": "protocols",
    "tunable": "observers.parts.options",
    "make_plant": "plants",
    "PlantSpec": "plants",
    "Controller": "protocols",
    "ControllerSpec": "controllers",
    "ControllerContext": "controllers.parts.common",
    "DesignContext": "synthesis.certificate",
    "Design": "synthesis.certificate",
    "Certificate": "synthesis.certificate",
    "require_certified": "synthesis.certificate",
    "no_certificate": "synthesis.certificate",
    "discretize_zoh": "dynamics.linear",
}
__all__ = [*_LAZY, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"pcbench.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'pcbench' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
