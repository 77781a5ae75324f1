"""The controllers of closed loops, one file each, and the dict that names them."""

from collections.abc import Callable
from typing import Any, NamedTuple

from pydantic import BaseModel

from pcbench.controllers import lqr, pd, pid, state_feedback
from pcbench.controllers.parts.common import ControllerContext, Sizes
from pcbench.protocols import Controller, Params
from pcbench.scenarios import Scenario
from pcbench.synthesis.lqr import Law


class ControllerSpec(NamedTuple):
    """A controller, its options, and how its numbers are made."""

    controller: Callable[[Any], Controller] | Controller  # options -> the law; or the law, whatever the options
    options: type[BaseModel]
    prepare: Callable[[Any, ControllerContext], Params]  # options -> params
    summary: str
    check: Callable[[Any, Sizes], None] | None = (
        None  # raises UserError where options do not fit; None: it is for one plant
    )
    linear: Callable[[Any, ControllerContext], Law | None] | None = (
        None  # the law about its set point, as eigenvalues need it
    )


def _pd(options: Any, context: ControllerContext) -> Params:
    return pd.prepare(options, context.delay, context.dt, context.rows, context.ticks, context.field, context.inverse)


CONTROLLERS = {
    "pd": ControllerSpec(pd.controller, pd.Options, _pd, "PD of two angles along a path, for the helicopter"),
    "state-feedback": ControllerSpec(
        state_feedback.controller,
        state_feedback.Options,
        state_feedback.prepare,
        "u = -K (xhat - x_ref) on the estimate",
        state_feedback.check,
        state_feedback.linear,
    ),
    "lqr": ControllerSpec(
        lqr.controller, lqr.Lqr, lqr.prepare, "state feedback by weights, for the sampled plant", lqr.check, lqr.linear
    ),
    "pid": ControllerSpec(
        pid.controller, pid.Options, pid.prepare, "PID on the outputs of the estimate", pid.check, pid.linear
    ),
}


def law_of(entry: ControllerSpec, options: Any) -> Controller:
    """Return the law that the options ask for."""
    return entry.controller if isinstance(entry.controller, Controller) else entry.controller(options)


def entry_of(scenario: Scenario) -> ControllerSpec:
    """Return the controller of a scenario's loop: the one that it carries itself, or else the one of its name."""
    return scenario.own["controller"].entry if "controller" in scenario.own else CONTROLLERS[scenario.loop.controller]
