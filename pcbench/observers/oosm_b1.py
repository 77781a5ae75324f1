"""oosm-b1: Kalman filter with an approximate update by an out-of-sequence sample, which neglects process noise.

As `oosm-a1`, with the estimated process noise 0: x(tau) = F x and P_vv = Q.

Source: Bar-Shalom 2002, algorithm B. It does not need the last innovation. Cost: as `oosm-a1`.
For one sample out of sequence by less than a step, its error is larger than that of `kf`, by 0.82 % in rms on the plant of
the tests. Its covariance includes the neglected term, so it is consistent (`test_late_samples`, `test_late_excess`).
Time index: xhat is the estimate of the present, after the jump.
"""

from pcbench.observers.oosm_a1 import last_update
from pcbench.observers.parts import linear_filter, retrodiction
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options
OBSERVER = retrodiction.observer(last_update, neglect_noise=True)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, and the maps back in time."""
    return retrodiction.design(context, options, "oosm-b1", 1, "it neglects the process noise in between")
