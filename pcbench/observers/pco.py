"""PCO and PI-PCO: piecewise continuous observers with a reduced-order (PI) observer at the samples.

In coordinates z = T x = [y; w] with C = [I 0], A_d(T) = e^{A T} is partitioned into y and w. Four systems are re-initialised
at every arrival t_i, at which sample i-1 becomes available:

 I, II  a clock, reset at each sample, measures the interval T_(i-1) between the last two samples (here: their ticks);
 III    z' = A z + B u from 0 gives M = [m1; m2], the input's response over that interval (2);
        then the reduced-order PI observer of the unmeasured part, in causal order (it uses sample i-1, not y_i):
            nu      = y_(i-1) - A11 y_(i-2) - m1 - A12 w_(i-2)
            w_(i-1) = A22 w_(i-2) + A21 y_(i-2) + m2 + Kp nu + L_(i-2)                       (12)
            L_(i-1) = L_(i-2) + Ki nu                                                        (14)
 IV     xhat(t_i) = A_d [y_(i-1); w_(i-1)] + M (18), then xhat' = A xhat + B u               (19)

PCO has Ki = 0. w_0 is the unmeasured part of the estimate at the first sample (at tick 0: of xhat(0)), and L_0 = 0.
Here the age of a sample may differ from the interval. Samples may be delayed by any age, jittered, lost (the interval is that
between received samples) or out of sequence (`parts/reorder_buffer`).
Because y is used as measured, xbar + inv(T) [nu; Kp nu + L] is a current estimator. So PCO is PCCEBO with the gain inv(T) [I;
Kp], except at the first sample.

Source: Li, Wang, Tian, PI Piecewise Continuous Observer Design.
Different from print: y_i has not arrived at t_i, so (12) is shifted by one sample; L_(t-1) is L_(i-1).
Sign: on the cart Kp < 0 smooths, and Kp > 0 amplifies noise. All channels share one clock.
Not claimed: that a stable F(T) (as printed) makes PI-PCO stable. The certificate is one Lyapunov matrix for all intervals of
the schedule without lost samples.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import prediction
from pcbench.observers.parts.common import xhat
from pcbench.observers.parts.options import StrictOptions, matrix, tunable
from pcbench.observers.parts.prediction import Memory, Motion, Point
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Leaf, Observer, Room
from pcbench.synthesis import parameter_ranges, reduced_order, riccati
from pcbench.synthesis.certificate import Design, DesignContext, one_clock, require_certified
from pcbench.synthesis.parameter_ranges import Range

Gain = Literal["lmi"] | float | list[list[float]] | None


class Gains(NamedTuple):
    """n states, m inputs, l outputs, w = n - l states that are not measured."""

    motion: Motion
    T: Float[Leaf, "n n"]  # to coordinates [y; w]
    T_inv: Float[Leaf, "n n"]  # back
    D: Float[Leaf, "l m"]
    Kp: Float[Leaf, "w l"]
    Ki: Float[Leaf, "w l"]
    room: Room  # for samples that may arrive after newer ones


class ReducedState(NamedTuple):
    """The reduced-order PI observer at the time of a sample."""

    point: Point  # inv(T) [y; w]
    L: Float[Array, " w"]  # the integral
    started: Bool[Array, ""]  # a sample has been used


class Proportional(StrictOptions):
    """Gain of PCO, in the coordinates [y; w]."""

    Kp: Gain = tunable(None, description="[n - q, q] gain, a number if it is 1 x 1; default: by LMI")
    decay: float = Field(0.0, ge=0, description="decay rate of the error that the certificate must contain [1/s]")
    period_range: Range | None = Field(
        None,
        description="shortest and longest sampling interval of the certificate [s]; default: those of the schedule",
    )
    parameter_range: dict[str, Range] | None = Field(
        None, description="smallest and largest value of model parameters, by name, of the certificate"
    )


class ProportionalIntegral(Proportional):
    """Gains of PI-PCO, in the coordinates [y; w]."""

    Ki: Gain = tunable(None, description="[n - q, q] gain of the integral, a number if it is 1 x 1; default: by LMI")


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Return the memory at xhat(0), before the first sample."""
    state = ReducedState(prediction.origin(xhat0), jnp.zeros(gains.Kp.shape[0]), jnp.asarray(False))
    return prediction.start(xhat0, state, gains.room, gains.D.shape[0])


def step_reduced(gains: Gains, before: ReducedState, sample: Measurement) -> ReducedState:
    """Run the reduced-order PI observer over one interval, (12) and (14)."""
    l = gains.D.shape[0]
    free = prediction.predict_to(gains.motion, before.point, sample.tick)
    prior = gains.T @ (sample.snapshot + free)  # A_d [y; w] + M
    nu = jnp.where(sample.mask, sample.value - prior[:l], 0.0)
    w_correction = jnp.where(before.started, gains.Kp @ nu + before.L, 0.0)
    L = before.L + jnp.where(before.started, gains.Ki @ nu, 0.0)
    xhat = gains.T_inv @ jnp.concatenate([prior[:l] + nu, prior[l:] + w_correction])
    return ReducedState(Point(xhat - sample.snapshot, sample.tick), L, jnp.asarray(True))


jump = prediction.make_jump(step_reduced, lambda state: state.point)
OBSERVER = Observer(init, prediction.snapshot, jump, prediction.flow, xhat)


def design(context: DesignContext, options: Proportional) -> Design:
    """Return Kp (and Ki), given or by LMI, certified for the schedule's intervals; raise DesignError without certificate."""
    integral = isinstance(options, ProportionalIntegral)
    name = "pi-pco" if integral else "pco"
    where = f"{name} in {context.scenario}"
    one_clock(context, name)
    maps = parameter_ranges.maps(context, options.period_range, options.parameter_range, 0.0, where)
    plant = reduced_order.partition(context.model, riccati.prior_size(context), maps, where)
    shape = (len(plant.T) - plant.outputs, plant.outputs)
    gain_options = {"Kp": options.Kp} | ({"Ki": options.Ki} if isinstance(options, ProportionalIntegral) else {})
    by_option = {name: value for name, value in gain_options.items() if value is not None and value != "lmi"}
    if 0 < len(by_option) < len(gain_options):
        raise UserError(f"{where}: got one of Kp and Ki, expected both or neither; the LMI finds them together.")
    dimensions = "unmeasured states x outputs"
    matrices = [matrix(value, shape, f"{where}: {name}", dimensions) for name, value in by_option.items()]
    Kp, Ki, certificate = reduced_order.design(plant, matrices, integral, options.decay, where)
    require_certified(certificate, where)
    motion = prediction.motion_of(context.model, context)
    gains = Gains(
        motion=motion,
        T=plant.T,
        T_inv=np.linalg.inv(plant.T),
        D=context.model.feedthrough,
        Kp=Kp,
        Ki=Ki,
        room=context.room,
    )
    return Design(gains, certificate)
