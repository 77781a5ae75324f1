"""ekf-iterated: the iterated extended Kalman filter: the sensor's slope is taken anew where each correction leads.

    z_0 = z-,   z_(i+1) = z- + K_i (y - h(z_i) - H_i (z- - z_i)),   K_i = P- H_i' (H_i P- H_i' + R)^-1,   H_i = dh/dz at z_i

for a fixed number of times; P by the last slope. It is Gauss-Newton on what a sample and the prediction say of z, so it finds
the likeliest z where that converges. Between samples it is `ekf`: mean and covariance go by slopes, tick by tick, and a sample
of any age is used at its own time (`parts/repropagation`).
Source: Bell, Cathey 1993.
Found: where y is linear in z nothing is left to iterate: it is `ekf`, and on a linear plant `kf`, to rounding.
Time index: the estimate is of now, after the jump. Not claimed: that the iteration converges; no step is ever shortened.
"""

import numpy as np
from jax import Array
from pydantic import Field

from pcbench.observers.parts import kalman, nonlinear_model, repropagation
from pcbench.observers.parts.kalman import Linear
from pcbench.observers.parts.nonlinear_model import Gains, clip_parameters, linearize_output
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.observers.parts.repropagation import State
from pcbench.protocols import InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext


class Options(nonlinear_model.Options):
    """What the filter assumes, and how often it looks again."""

    iterations: int = Field(3, ge=1, le=100, description="corrections per sample")


def tick(gains: Gains, now: Now, state: State) -> State:
    """Move mean and covariance by the slope there."""
    F = gains.slope(now, state.mean)
    return state._replace(mean=clip_parameters(gains, gains.motion(now, state.mean)), P=F @ state.P @ F.T + gains.Q)


def update_about(
    gains: Gains, now: Now, state: State, sample: Measurement, about: Array
) -> tuple[Array, Array, InnovationStats]:
    """Return what z is once a sample is known, by the sensor's slope at `about`."""
    return kalman.by_slope(gains, state.mean, state.P, Linear(*linearize_output(gains, now, about), about), sample)


def update(gains: Gains, now: Now, state: State, sample: Measurement) -> State:
    """Correct by a sample of the state's tick, as often as `own` is long."""
    z, P = state.mean, state.P
    for _ in range(gains.own.shape[0]):
        z, P, _ = update_about(gains, now, state, sample, z)
    return state._replace(mean=clip_parameters(gains, z), P=P)


def innovation_at_mean(gains: Gains, now: Now, state: State, sample: Measurement) -> InnovationStats:
    """Return how far a sample is from what is expected of it, by the slope at the prediction."""
    return update_about(gains, now, state, sample, state.mean)[2]


OBSERVER = repropagation.observer(repropagation.Way(tick, update, innovation_at_mean))


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes; there is no certificate for a nonlinear model."""
    own = np.zeros(options.iterations)  # its length alone is the message (`protocols.Room`)
    return nonlinear_model.design(setting, options, "ekf-iterated", lambda gains: own)
