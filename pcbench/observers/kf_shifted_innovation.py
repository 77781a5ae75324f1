"""kf-shifted-innovation: Kalman filter that adds the innovation of a delayed sample to the present estimate.

    P- = E P E' + Q,   xhat(now) <- xhat(now) + K (y - C (xhat(now) - (g(now) - g(t_m)))),   K = P- c (c'P- c + r)^-1

g is the response to the input from zero state (for a robot's pose: its odometry). The estimate at the sampling time is
approximated by the present estimate minus the change of g since. WPILib's pose estimators use delayed camera poses in this
way.

Source: WPILib, pose estimators, which have a constant K; here K is the filter's. Memory: one mean and covariance. Cost: one
update per sample.
The method assumes that the plant is an integrator, x' = B u, so that an error stays constant over the delay. For such a plant
without process noise it equals `kf`, with delayed, lost and out-of-sequence samples. For other plants the approximation is
wrong, and even a perfect start leads to an error (`test_late_samples`).
Time index: xhat is the estimate of the present, after the jump.
"""

import numpy as np

from pcbench.observers.parts import linear_filter, reorder_buffer
from pcbench.observers.parts.prediction import Memory
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Arrival, Gains, InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def shift_to_now(gains: Gains, now: Now, arrival: Arrival) -> Measurement:
    """Return the arrival as a sample taken now, with the snapshot of its sampling time."""
    return reorder_buffer.sample_of(now, arrival, gains.D)._replace(tick=now.tick)


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Compare the sample with the present estimate, shifted by the response to the input, and correct the present estimate."""
    return linear_filter.use_sample(gains, memory, now, shift_to_now(gains, now, arrival))


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return the innovation statistics of the arriving sample, relative to the shifted present estimate."""
    before = linear_filter.newest(gains, memory)
    return linear_filter.newest_innovation_stats(gains, before, shift_to_now(gains, now, arrival))


OBSERVER = linear_filter.FILTER._replace(jump=jump, innovation=innovation)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; no room is needed, because every update is at the present."""
    return linear_filter.design(
        context,
        options,
        "kf-shifted-innovation",
        np.zeros(0),
        reason="it assumes that the plant is an integrator",
        restarts=False,
    )
