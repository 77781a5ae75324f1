"""ekf-iterated: iterated extended Kalman filter, which linearises the sensor again at each corrected estimate.

    z_0 = z-,   z_(i+1) = z- + K_i (y - h(z_i) - H_i (z- - z_i)),   K_i = P- H_i' (H_i P- H_i' + R)^-1,   H_i = dh/dz at z_i

The number of iterations is fixed, and P uses the last H_i. The iteration is a Gauss-Newton search for the most likely z,
given the sample and the prediction. Between samples the filter is `ekf`: it propagates mean and covariance by Jacobians, tick
by tick. A sample of any age is used at its sampling time (`parts/repropagation`).
Source: Bell, Cathey 1993.
If y is linear in z, the iteration changes nothing: the filter equals `ekf`, and on a linear plant `kf`, up to rounding.
Time index: xhat is the estimate of the present, after the jump.
Not claimed: convergence of the iteration. There is no step-size control.
"""

import numpy as np
from pydantic import Field

from pcbench.observers.parts import kalman, nonlinear_model, repropagation
from pcbench.observers.parts.nonlinear_model import Gains, clip_parameters
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.observers.parts.repropagation import State
from pcbench.protocols import InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext


class Options(nonlinear_model.Options):
    """Assumptions of the filter, and the number of iterations."""

    iterations: int = Field(3, ge=1, le=100, description="corrections per sample")


def tick(gains: Gains, now: Now, state: State) -> State:
    """Propagate mean and covariance by one tick, by the Jacobian at the mean."""
    F = gains.jacobian(now, state.mean)
    return state._replace(mean=clip_parameters(gains, gains.motion(now, state.mean)), P=F @ state.P @ F.T + gains.Q)


def update(gains: Gains, now: Now, state: State, sample: Measurement) -> State:
    """Update by a sample of the state's tick, with as many iterations as `extra` has entries."""
    z, P = state.mean, state.P
    for _ in range(gains.extra.shape[0]):
        z, P, _ = kalman.update_linearized(gains, now, state.mean, state.P, sample, z)
    return state._replace(mean=clip_parameters(gains, z), P=P)


def innovation_at_mean(gains: Gains, now: Now, state: State, sample: Measurement) -> InnovationStats:
    """Return the innovation statistics of a sample, with the sensor linearised at the prediction."""
    return kalman.update_linearized(gains, now, state.mean, state.P, sample, state.mean)[2]


OBSERVER = repropagation.observer(repropagation.FilterFunctions(tick, update, innovation_at_mean))


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; a nonlinear model has no certificate."""
    iterations = np.zeros(options.iterations)  # its length is the number of iterations (`protocols.Room`)
    return nonlinear_model.design(context, options, "ekf-iterated", lambda gains: iterations)
