"""kf-reprocess: Kalman filter that stores its newest samples with the state before them, and filters them again if necessary.

An out-of-sequence sample is inserted among the `keep` newest, and the filter runs again from the state before the oldest of
them. A sample older than that state is lost.

Source: Moore, Stouch 2014 (robot_localization's smoothing of a delayed filter). Memory: `keep` samples, one mean and one
covariance. Cost: `keep` + 1 updates per sample, whether or not it is out of sequence.
It equals `kf` up to rounding as long as at most `keep` newer samples arrive before a sample; `kf` stores as many as the
schedule can need. The design reports this number as `needed`, and gives no certificate if it is above `keep`.
Time index: xhat is the estimate of the present, after the jump.
"""

import numpy as np
from pydantic import Field

from pcbench.observers.parts import linear_filter, reorder_buffer
from pcbench.observers.parts.common import select_memory
from pcbench.observers.parts.prediction import Memory
from pcbench.protocols import Arrival, Gains, Now
from pcbench.synthesis.certificate import Design, DesignContext


class Options(linear_filter.Options):
    """Number of stored samples."""

    keep: int = Field(8, ge=1, le=256, description="number of past measurements that are stored and filtered again")


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Use a sample unless it is older than the state before the stored samples."""
    sample = reorder_buffer.zero_missing(reorder_buffer.sample_of(now, arrival, gains.D))
    updated_memory = linear_filter.use_sample(gains, memory, now, sample)
    return select_memory(sample.mask & (sample.tick >= memory.buffer.before.tick), updated_memory, memory)


OBSERVER = linear_filter.FILTER._replace(jump=jump)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, without a certificate if the schedule needs more stored samples than `keep`."""
    needs_more = context.oosm_lag > options.keep
    reason = f"it stores {options.keep} samples, but {context.oosm_lag} newer ones may arrive before a sample"
    kf_design = linear_filter.design(
        context, options, "kf-reprocess", np.zeros(options.keep), reason=reason if needs_more else "", restarts=False
    )
    numbers = {**kf_design.certificate.numbers, "kept": float(options.keep), "needed": float(context.oosm_lag)}
    return kf_design._replace(certificate=kf_design.certificate._replace(numbers=numbers))
