"""kf-drop-delayed: the Kalman filter that uses what is young enough, at its own time, and drops what is older than a limit.

Source: Kalman 1960, and a line in most trackers' configuration. Keeps and costs what `kf` does for the samples it uses.
Found: where nothing is older than the limit it is `kf`; between the samples it keeps its covariance is that of the model
alone, and it is honest about it: what it drops costs it error, not truth (`test_late_samples`).
Time index: the estimate is of now, after the jump.
"""

import numpy as np
from pydantic import Field

from pcbench.observers.parts import linear_filter
from pcbench.observers.parts.common import select_memory
from pcbench.observers.parts.prediction import Memory
from pcbench.protocols import Arrival, Gains, InnovationStats, Now
from pcbench.synthesis.certificate import Design, DesignContext


class Options(linear_filter.Options):
    """How old a sample may be."""

    max_age: float | None = Field(
        None,
        ge=0,
        description="largest age of a measurement that is used [s]; default: the shortest sampling period",
    )


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Use what is no older than the limit [ticks]."""
    mask = arrival.mask & (arrival.age <= gains.own)
    return select_memory(mask, linear_filter.jump(gains, memory, now, arrival._replace(mask=mask)), memory)


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return how far what is used is from what was expected of it."""
    young = arrival._replace(mask=arrival.mask & (arrival.age <= gains.own))
    return linear_filter.innovation(gains, memory, now, young)


OBSERVER = linear_filter.FILTER._replace(jump=jump, innovation=innovation)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes, and the limit in ticks."""
    limit = min(setting.period) if options.max_age is None else round(options.max_age / setting.dt)
    why = "" if limit >= max(setting.delay) else "it drops what is late"
    return linear_filter.design(
        setting, options, "kf-drop-delayed", own=np.asarray(limit), unproven=why, restarts=False
    )
