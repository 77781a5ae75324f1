"""kf-reprocess: the Kalman filter that keeps its newest samples with the state before them, goes back, and filters again.

A sample that comes after newer ones is put in its place among the `keep` newest; the filter runs again from the state
before the oldest of them. One that is older than all those kept is lost.

Source: Moore, Stouch 2014 (robot_localization's smoothing of a lagged filter). Keeps `keep` samples and one mean and
covariance before them; here a sample costs `keep` + 1 updates whatever its place, which is what the worst of them costs.
Found: it is `kf` to rounding while no sample is overtaken by more than `keep` others; `kf` is the same rule with just
as many places as the schedule can need. Its design says how many those are, and is no certificate where they are more
than `keep`.
Time index: the estimate is of now, after the jump.
"""

import numpy as np
from pydantic import Field

from pcbench.observers.parts import linear_filter, reorder_buffer
from pcbench.observers.parts.common import select_memory
from pcbench.observers.parts.prediction import Memory
from pcbench.protocols import Arrival, Gains, Now
from pcbench.synthesis.certificate import Design, DesignContext


class Options(linear_filter.Options):
    """How far it can go back."""

    keep: int = Field(8, ge=1, le=256, description="number of past measurements that are stored and filtered again")


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Use what is no older than the state before the samples kept."""
    sample = reorder_buffer.kept_of(reorder_buffer.sample_of(now, arrival, gains.D))
    used = linear_filter.use(gains, memory, now, sample)
    return select_memory(sample.mask & (sample.taken >= memory.buffer.before.taken), used, memory)


OBSERVER = linear_filter.FILTER._replace(jump=jump)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes; say where it keeps too few."""
    short = f"it keeps {options.keep} samples, and {setting.overtaking} may arrive before one: older ones are lost"
    why = short if setting.overtaking > options.keep else ""
    found = linear_filter.design(setting, options, "kf-reprocess", np.zeros(options.keep), unproven=why, restarts=False)
    numbers = {**found.certificate.numbers, "kept": float(options.keep), "needed": float(setting.overtaking)}
    return found._replace(certificate=found.certificate._replace(numbers=numbers))
