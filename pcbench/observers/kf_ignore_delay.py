"""kf-ignore-delay: Kalman filter that uses a delayed sample as if it had been taken at its arrival.

    P- = E P E' + Q,   xhat <- xhat + K (y - C xhat(now)),   K = P- c (c'P- c + r)^-1

Mean and covariance are predicted from one arrival to the next, whatever the age of the sample. This is what a filter computes
if its timestamps are not used.

Source: Kalman 1960. Memory: one mean and covariance. Cost: one update per sample.
Without delay it is `kf`. If samples have age d, the error on a steady motion is the change of the output over d, however many
samples there are. The covariance does not contain this error, so it is optimistic (`test_late_samples`).
Time index: xhat is the estimate of the present, after the jump. Not claimed: perfect start.
"""

import jax.numpy as jnp
import numpy as np

from pcbench.observers.parts import linear_filter
from pcbench.observers.parts.prediction import Memory
from pcbench.protocols import Arrival, Gains, InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def of_now(memory: Memory, arrival: Arrival) -> Arrival:
    """Return an arrival with age 0 and the present snapshot."""
    return arrival._replace(age=jnp.zeros_like(arrival.age), snapshot=memory.g)


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Use the arriving sample as if it had been taken now."""
    return linear_filter.jump(gains, memory, now, of_now(memory, arrival))


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return the innovation statistics of the arriving sample, relative to the present prediction."""
    return linear_filter.innovation(gains, memory, now, of_now(memory, arrival))


OBSERVER = linear_filter.FILTER._replace(jump=jump, innovation=innovation)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; no room is needed, because every sample counts as the newest."""
    return linear_filter.design(context, options, "kf-ignore-delay", np.zeros(0), reason="it ignores delays")
