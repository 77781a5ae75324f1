"""oosm-a1: an out-of-sequence sample by exact retrodiction of one step.

The filter stands at its newest sample and predicts to now as `kf` does. A sample that is older goes back by the last
update (`parts/retrodiction`), the noise between being estimated by that update's innovation, v = Q u.

Source: Bar-Shalom 2002, algorithm A. Keeps mean, covariance, the one before the last update and its innovation; costs one
update in order, and out of order one of 2 n states with a map back in time.
Found: for one sample that is late by less than one step it is `kf` to rounding, as said. For a second one in the same
step the last update is no more all that has been learnt, and it lies above; one older than a step is lost. It needs e^{-A
t}: on a plant with a mode that dies within the lag its digits are lost; `kf` and `kf-cloning` never go back
(`test_late_samples`).
Time index: the estimate is of now, after the jump.
"""

from jax import Array

from pcbench.observers.parts import linear_filter, retrodiction
from pcbench.observers.parts.linear_filter import Gains
from pcbench.observers.parts.retrodiction import Last, Memory
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options


def last(gains: Gains, memory: Memory, taken: Array) -> Last:
    """Return the last update, whatever came before it."""
    return memory.last


OBSERVER = retrodiction.observer(last, zero=False)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes, and the maps back in time."""
    return retrodiction.design(setting, options, "oosm-a1", 1, "one step back, whatever the lag")
