"""PCCEBO: piecewise continuous, current-estimator-based observer.

    xbar_m = Phi xhat_(m-1) + I(t_(m-1), t_m),   xbar_0 = xhat(0)                            (8a), with the exact integral
    xhat_m = xbar_m + L (y_m - C xbar_m)                                                     (8b), when sample m arrives
    xhat(t_i) = e^{A d} xhat_m + I(t_m, t_i)                                                 (11), for any age d of the sample
    xhat(t) = e^{A (t - t_i)} xhat(t_i) + I(t_i, t)                                          (12)

The source writes it as two piecewise continuous systems: one integrates the input, and the other is the estimate,
re-initialised at each arrival. Without noise and with a true model, the error does not depend on u: e(t) = e^{A (t - t_m)}
e_m with e_m = (I - L C) Phi e_(m-1).

(11) and (12) are in `parts/prediction`. An out-of-sequence sample is inserted at its sampling time (`parts/reorder_buffer`).
A lost sample lengthens the interval of (8a).

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017) 3738-3751, doi 10.3906/elk-1606-160.
Different from print: (7) and (8a) hold the input over a whole sampling period, while the integral here is exact. (11) is
printed for d = te only.
Time index: xhat is the estimate of the present, after the jump. All channels share one clock.
Not claimed: noise filtering; with the paper's L = [1, 0] the position estimate at a sample is the measurement. The
certificate is for the mean period. It covers varying intervals only with `period_range`.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float
from pydantic import Field

from pcbench.dynamics.observability import require_detectable
from pcbench.observers.parts import prediction
from pcbench.observers.parts.common import xhat
from pcbench.observers.parts.options import StrictOptions, matrix, method_option, tunable
from pcbench.observers.parts.prediction import Memory, Motion, Point
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Leaf, Observer, Room
from pcbench.synthesis import current_gains, parameter_ranges
from pcbench.synthesis.certificate import Design, DesignContext, one_clock
from pcbench.synthesis.parameter_ranges import Range


class Gains(NamedTuple):
    """n states, m inputs, q outputs."""

    motion: Motion
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    L: Float[Leaf, "n q"]
    room: Room  # for samples that may arrive after newer ones


class Options(StrictOptions):
    """Design method of the gain, and requirements on its certificate."""

    gain: Literal["lmi", "riccati", "decay", "h2", "hinf"] = method_option(
        "lmi",
        description="design: LMI (23), stationary Kalman filter, fastest decay over a range, or least noise in the estimate "
        "(H2 or H-infinity norm)",
    )
    L: list[list[float]] | None = tunable(None, description="[n, q] gain, instead of a computed one")
    q: float = Field(
        0.002, gt=0, description="riccati, h2, hinf: assumed intensity of the process noise through the input"
    )
    decay: float | None = Field(
        None, gt=0, description="decay rate of the error that the certificate must contain [1/s]"
    )
    period_range: Range | None = Field(
        None, description="shortest and longest sampling interval of the certificate [s]; default: the mean"
    )
    parameter_range: dict[str, Range] | None = Field(
        None, description="smallest and largest value of model parameters, by name, of the certificate"
    )


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0)."""
    return prediction.start(xhat0, prediction.origin(xhat0), gains.room, gains.C.shape[0])


def correct(gains: Gains, before: Point, sample: Measurement) -> Point:
    """Correct at the sampling time, (8a) and (8b)."""
    free = prediction.predict_to(gains.motion, before, sample.tick)
    xbar = sample.snapshot + free
    innovation = jnp.where(sample.mask, sample.value - gains.C @ xbar, 0.0)
    return Point(free + gains.L @ innovation, sample.tick)


jump = prediction.make_jump(correct, lambda point: point)
OBSERVER = Observer(init, prediction.snapshot, jump, prediction.flow, xhat)


def design(context: DesignContext, options: Options) -> Design:
    """Return L for the (mean) sampling period or a range, with its certificate; raise DesignError without one."""
    one_clock(context, "pccebo")
    where = f"pccebo in {context.scenario}"
    require_detectable(context.model, where)
    shape = context.model.C.T.shape
    option_L = None if options.L is None else matrix(options.L, shape, f"{where}: L", "states x outputs")
    has_range = options.period_range is not None or options.parameter_range is not None
    maps = None
    if has_range:
        maps = parameter_ranges.maps(context, options.period_range, options.parameter_range, options.q, where)
    L, certificate = current_gains.find(context, options.gain, option_L, options.q, options.decay, maps, where)
    motion = prediction.motion_of(context.model, context)
    return Design(Gains(motion, context.model.C, context.model.feedthrough, L, context.room), certificate)
