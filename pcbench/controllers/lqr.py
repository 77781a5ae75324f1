"""lqr: linear-quadratic regulator for the plant sampled at the controller's period.

    u = -K x minimises sum x'Q1 x + u'Q2 u over decisions, for the nominal plant with held input

K is `synthesis.lqr.gain`; law, set points and times are those of `state_feedback`. By default it uses the (mean) delay of its
command: feedback of the predicted state is then optimal, and only the unavoidable cost of the delay remains. The delay of the
measurements is the observer's task, which estimates the present state. The metric `lq_cost` has the same weights.
"""

import numpy as np
from pydantic import Field

from pcbench.controllers import state_feedback
from pcbench.controllers.parts import common
from pcbench.controllers.parts.common import ControllerContext, Sizes, Weight
from pcbench.dynamics.linear import Matrix
from pcbench.synthesis import lqr


class Lqr(common.Options):
    """The weights, and the options of all laws."""

    Q1: Weight = Field(description="weight of the state: a number, n numbers, or [n, n]")
    Q2: Weight = Field(description="weight of the input: a number, m numbers, or [m, m]")
    knows_delay: bool = Field(True, strict=True, description="use the state predicted to the arrival of the command")


def check(options: Lqr, sizes: Sizes) -> None:
    """Raise UserError if the options do not fit the plant."""
    common.require_common(options, sizes, definite=True)


def gain(options: Lqr, context: ControllerContext) -> Matrix:
    """Return K [m, n]; raise DesignError without a stabilising one."""
    (Phi, Gamma), (n, m) = context.tick, context.model.B.shape
    sizes = Sizes(context.states, m, len(context.model.C), context.dt, "controller")
    Q1, Q2 = common.matrix(options.Q1, (n, n), "Q1", sizes), common.matrix(options.Q2, (m, m), "Q2", sizes)
    return lqr.gain(*lqr.over_period((Phi, Gamma), context.period_ticks(options.period)), Q1, Q2, "controller lqr")


def prepare(options: Lqr, context: ControllerContext) -> state_feedback.Params:
    """Return the parameters of the law."""
    return state_feedback.numbers(options, context, gain(options, context))


def linear(options: Lqr, context: ControllerContext) -> lqr.Law:
    """Return the law linearised about its set point."""
    return state_feedback.of_gain(np.asarray(gain(options, context)))


controller = state_feedback.controller
