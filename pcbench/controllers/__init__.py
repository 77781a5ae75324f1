"""The controllers of closed loops, one file each, and the dict of them by name."""

from collections.abc import Callable
from typing import Any, NamedTuple

from pydantic import BaseModel

from pcbench.controllers import lqr, pd, pid, state_feedback
from pcbench.controllers.parts.common import ControllerContext, Sizes
from pcbench.protocols import Controller, Params
from pcbench.scenarios import Scenario
from pcbench.synthesis.lqr import Law


class ControllerSpec(NamedTuple):
    """A control law, its options, and the computation of its numbers."""

    controller: Callable[[Any], Controller] | Controller  # options -> the law; or the law, for all options
    options: type[BaseModel]  # a pydantic model
    prepare: Callable[[Any, ControllerContext], Params]  # (options, context) -> params of the law
    summary: str  # one line for `pcbench list`
    # raises UserError if options do not fit the plant; None: the law is for one plant
    check: Callable[[Any, Sizes], None] | None = None
    # the law linearised about its set point, for the eigenvalues of the loop
    linear: Callable[[Any, ControllerContext], Law | None] | None = None


def _pd(options: Any, context: ControllerContext) -> Params:
    return pd.prepare(options, context.delay, context.dt, context.rows, context.ticks, context.field, context.inverse)


CONTROLLERS = {
    "pd": ControllerSpec(pd.controller, pd.Options, _pd, "PD control of two angles along a path, for the helicopter"),
    "state-feedback": ControllerSpec(
        state_feedback.controller,
        state_feedback.Options,
        state_feedback.prepare,
        "state feedback of the estimate: u = -K (xhat - x_ref)",
        state_feedback.check,
        state_feedback.linear,
    ),
    "lqr": ControllerSpec(
        lqr.controller, lqr.Lqr, lqr.prepare, "linear-quadratic regulator for the sampled plant", lqr.check, lqr.linear
    ),
    "pid": ControllerSpec(
        pid.controller, pid.Options, pid.prepare, "PID control of the estimated outputs", pid.check, pid.linear
    ),
}


def law_of(entry: ControllerSpec, options: Any) -> Controller:
    """Return the control law for the options."""
    return entry.controller if isinstance(entry.controller, Controller) else entry.controller(options)


def entry_of(scenario: Scenario) -> ControllerSpec:
    """Return the controller of a scenario's loop: its own one, or the built-in one of its name."""
    return (
        scenario.user_code["controller"].entry
        if "controller" in scenario.user_code
        else CONTROLLERS[scenario.loop.controller]
    )
