"""kf-shifted-innovation: the innovation of a delayed measurement, added to the present estimate.

Between the two is the integral of the input.

    P- = E P E' + Q,   xhat(now) <- xhat(now) + K (y - C (xhat(now) - (g(now) - g(t_m)))),   K = P- c (c'P- c + r)^-1

g is the response to the input from zero state, as odometry is to a pose: the estimate of the sample's time is taken to be
that of now less what g has moved since, and the correction is added to now. So pose estimators take in a camera's fix
(WPILib).

Source: WPILib, pose estimators, which have a constant K where here it is the filter's. Keeps one mean and one covariance;
costs one update a sample. Found: it knows the input and takes the plant for an integrator, so what was wrong then is as
wrong now. Of x' = B u without process noise that is so, and it is `kf`, late, lost and overtaking samples included. With
other modes the late sample is compared with an estimate that has moved on, and even a perfect start goes wrong
(`test_late_samples`).
Time index: the estimate is of now, after the jump.
"""

import numpy as np

from pcbench.observers.parts import linear_filter, reorder_buffer
from pcbench.observers.parts.prediction import Memory
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Arrival, Gains, InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def shift_to_now(gains: Gains, now: Now, arrival: Arrival) -> Measurement:
    """Return what arrives as a sample of now with the note of its own time."""
    return reorder_buffer.sample_of(now, arrival, gains.D)._replace(taken=now.tick)


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Compare with the response to the input of the sample's own time, and correct now."""
    return linear_filter.use(gains, memory, now, shift_to_now(gains, now, arrival))


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return how far what arrives is from what is expected of it by the estimate of now."""
    return linear_filter.surprise(gains, linear_filter.newest(gains, memory), shift_to_now(gains, now, arrival))


OBSERVER = linear_filter.FILTER._replace(jump=jump, innovation=innovation)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes; it needs no room, as every correction is one of now."""
    return linear_filter.design(
        setting,
        options,
        "kf-shifted-innovation",
        np.zeros(0),
        unproven="it assumes that the plant is an integrator",
        restarts=False,
    )
