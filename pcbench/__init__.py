"""pcbench: which observer should I use when my measurements are sampled, late, noisy or lost, and how sure am I?

    import pcbench
    pcbench.setup()                       # all CPUs, float64, compiled programs remembered
    result = pcbench.run("quick")         # .stats, .pairs, .runs as pandas frames

Nothing heavy is imported before it is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names, for type checkers and editors
    from pcbench.api import costs as costs
    from pcbench.api import design as design
    from pcbench.api import exact as exact
    from pcbench.api import run as run
    from pcbench.api import trace as trace
    from pcbench.controllers import ControllerEntry as ControllerEntry
    from pcbench.controllers.parts.told import Told as Told
    from pcbench.dataset.exact import Exact as Exact
    from pcbench.dataset.result import Result as Result
    from pcbench.dataset.result import opened as opened
    from pcbench.dynamics.linear import held as held
    from pcbench.errors import DesignError as DesignError
    from pcbench.errors import UserError as UserError
    from pcbench.gains.design import trade_off as trade_off
    from pcbench.gains.tune import tune as tune
    from pcbench.logs.described import log as log
    from pcbench.machine.process import setup as setup
    from pcbench.observers import Entry as Entry
    from pcbench.observers.parts.options import tunable as tunable
    from pcbench.plants import PlantEntry as PlantEntry
    from pcbench.plants import plant as plant
    from pcbench.protocols import Arrival as Arrival
    from pcbench.protocols import Controller as Controller
    from pcbench.protocols import Now as Now
    from pcbench.protocols import Observer as Observer
    from pcbench.protocols import Plant as Plant
    from pcbench.protocols import Surprise as Surprise
    from pcbench.protocols import together as together
    from pcbench.replaying.replay import replay as replay
    from pcbench.replaying.tuning import tune_log as tune_log
    from pcbench.study.interop import lti as lti
    from pcbench.study.interop import to_control as to_control
    from pcbench.study.interop import to_scipy as to_scipy
    from pcbench.sufficing.asking import suffices as suffices
    from pcbench.synthesis.certificate import Certificate as Certificate
    from pcbench.synthesis.certificate import Design as Design
    from pcbench.synthesis.certificate import Setting as Setting
    from pcbench.synthesis.certificate import certified as certified
    from pcbench.synthesis.certificate import uncertified as uncertified

__version__ = "0.1.0"

_LAZY = {
    "run": "api",
    "exact": "api",
    "costs": "api",
    "trace": "api",
    "design": "api",
    "trade_off": "gains.design",
    "tune": "gains.tune",
    "suffices": "sufficing.asking",
    "log": "logs.described",
    "replay": "replaying.replay",
    "tune_log": "replaying.tuning",
    "opened": "dataset.result",
    "Result": "dataset.result",
    "Exact": "dataset.exact",
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
    "Surprise": "protocols",
    "Entry": "observers",
    "together": "protocols",
    "tunable": "observers.parts.options",
    "plant": "plants",
    "PlantEntry": "plants",
    "Controller": "protocols",
    "ControllerEntry": "controllers",
    "Told": "controllers.parts.told",
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
