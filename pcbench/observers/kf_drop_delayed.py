"""kf-drop-delayed: Kalman filter that uses samples up to a maximum age at their sampling time, and drops older ones.

Source: Kalman 1960; many trackers have such an option. Memory and cost per used sample are those of `kf`.
If no sample is older than the limit, it equals `kf`. The covariance accounts for dropped samples, so it stays consistent:
dropping increases the error, and P with it (`test_late_samples`).
Time index: xhat is the estimate of the present, after the jump.
"""

import numpy as np
from pydantic import Field

from pcbench.observers.parts import linear_filter
from pcbench.observers.parts.common import select_memory
from pcbench.observers.parts.prediction import Memory
from pcbench.protocols import Arrival, Gains, InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext


class Options(linear_filter.Options):
    """Maximum age of a sample."""

    max_age: float | None = Field(
        None, ge=0, description="largest age of a measurement that is used [s]; default: the shortest sampling period"
    )


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Use samples whose age is at most the limit [ticks]."""
    mask = arrival.mask & (arrival.age <= gains.extra)
    return select_memory(mask, linear_filter.jump(gains, memory, now, arrival._replace(mask=mask)), memory)


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return the innovation statistics of the samples that are used."""
    usable = arrival._replace(mask=arrival.mask & (arrival.age <= gains.extra))
    return linear_filter.innovation(gains, memory, now, usable)


OBSERVER = linear_filter.FILTER._replace(jump=jump, innovation=innovation)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, and the limit in ticks."""
    limit = min(context.period) if options.max_age is None else round(options.max_age / context.dt)
    reason = "" if limit >= max(context.delay) else "it drops delayed samples"
    return linear_filter.design(
        context, options, "kf-drop-delayed", extra=np.asarray(limit), reason=reason, restarts=False
    )
