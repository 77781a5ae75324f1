"""kf-ignore-delay: the Kalman filter that takes a late sample for one of now.

    P- = E P E' + Q,   xhat <- xhat + K (y - C xhat(now)),   K = P- c (c'P- c + r)^-1

carried from the last arrival to this one, whatever the sample's age. What most filters do until somebody looks at the
stamps.

Source: Kalman 1960, on data that are not what it was made for. Keeps one mean and one covariance; costs one update a
sample.
Found: at delay 0 it is `kf`. With samples of age d its error on a steady motion is what the output moves over d, from
which no number of samples helps; and it is optimistic, for P knows nothing of it (`test_late_samples`).
Time index: the estimate is of now, after the jump. Not claimed: perfect start.
"""

import jax.numpy as jnp
import numpy as np

from pcbench.observers.parts import linear_filter
from pcbench.observers.parts.prediction import Memory
from pcbench.protocols import Arrival, Gains, InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def of_now(memory: Memory, arrival: Arrival) -> Arrival:
    """Return what arrives as if it were of now."""
    return arrival._replace(age=jnp.zeros_like(arrival.age), snapshot=memory.g)


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Use what arrives as if it were of now."""
    return linear_filter.jump(gains, memory, now, of_now(memory, arrival))


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return how far what arrives is from what is expected of now."""
    return linear_filter.innovation(gains, memory, now, of_now(memory, arrival))


OBSERVER = linear_filter.FILTER._replace(jump=jump, innovation=innovation)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes; it needs no room, as to it no sample is older than another."""
    return linear_filter.design(setting, options, "kf-ignore-delay", np.zeros(0), unproven="it ignores delays")
