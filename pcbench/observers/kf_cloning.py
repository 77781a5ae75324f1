"""kf-cloning: Kalman filter with stochastic cloning: the state contains copies of itself from past sampling times.

The gain is K = h / s for the whole augmented state (`parts/stochastic_cloning`). Each sample updates the present state and
every copy, through the copy of its sampling time.

Source: Roumeliotis, Burdick 2002 (stochastic cloning, there for relative measurements); delayed measurements with an
augmented state are common.
Memory: J + 1 states and their joint covariance, with J the largest number of samples in transit. Cost: an update of all of
them.
It equals `kf` up to rounding for delayed, lost and out-of-sequence samples, as arXiv 2508.21260 states; `kf` needs n states
only. It needs a signal when a sample is taken. The copy of a lost sample is stored until it is overwritten.
Time index: xhat is the estimate of the present, after the jump.
"""

from pcbench.observers.parts import linear_filter, stochastic_cloning
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options
OBSERVER = stochastic_cloning.observer(lambda h, s, pair_mask: h / s)._replace(innovation=stochastic_cloning.innovation)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions, with room for the copies."""
    return linear_filter.design(context, options, "kf-cloning", extra=stochastic_cloning.room(context, "kf-cloning"))
