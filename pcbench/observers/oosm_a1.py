"""oosm-a1: Kalman filter with an exact update by an out-of-sequence sample, at most one step old.

The filter is at its newest sample and predicts to the present as `kf` does. To use an older sample, the estimate is
retrodicted across the last update (`parts/retrodiction`). The process noise in between is estimated from the innovation of
that update, v = Q u.

Source: Bar-Shalom 2002, algorithm A. Memory: mean, covariance, the prediction before the last update, and its innovation.
Cost: one update for a sample in order; otherwise one update of 2 n states and a map back in time.

Properties (`test_late_samples`):

- If at most one sample per step is out of sequence, by less than one step, it equals `kf` up to rounding.
- For a second such sample in the same step, it neglects the first one's information, and the error is larger than that of
  `kf`. A sample older than one step is lost.
- It needs e^{-A t}. If a mode of the plant decays within the lag, this loses all digits; `kf` and `kf-cloning` do not need
  it.

Time index: xhat is the estimate of the present, after the jump.
"""

from jax import Array

from pcbench.observers.parts import linear_filter, retrodiction
from pcbench.observers.parts.linear_filter import Gains
from pcbench.observers.parts.retrodiction import LastUpdate, Memory
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def last_update(gains: Gains, memory: Memory, tick: Array) -> LastUpdate:
    """Return the last update of the memory."""
    return memory.last_update


OBSERVER = retrodiction.observer(last_update, neglect_noise=False)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, and the maps back in time."""
    return retrodiction.design(context, options, "oosm-a1", 1, "it goes back by one update only")
